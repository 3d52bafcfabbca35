"""Settings of one ODrive axis; scales and limits come from the drive itself."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from leactl.driver.contract import SAFE_STATE_S, DriverSettings
from leactl_plugins.odrive_can.can_simple import identifiers_of
from leactl_plugins.odrive_can.endpoints import EndpointTable, read_table


class OdriveSettings(DriverSettings):
    """Everything that differs from drive to drive."""

    node: Annotated[int, Field(strict=True, ge=0, le=62)]  # 63 stands for a drive without a node
    endpoints: str  # path of the firmware's flat_endpoints.json, or "emulated"
    sign: Literal[-1, 1] = 1
    watchdog_ms: Annotated[int, Field(strict=True, ge=10, le=round(SAFE_STATE_S * 1000))] = 100
    heartbeat_ms: Annotated[int, Field(strict=True, ge=2, le=100)] = 20
    bus_voltage_period_s: Annotated[float, Field(strict=True, ge=0.05, le=60)] = 0.2
    answer_timeout_s: Annotated[float, Field(strict=True, gt=0, le=SAFE_STATE_S)] = 0.1
    reset_fault_at_start: bool = False
    # of the emulated drive; the values of a real drive are read from it
    emulated_torque_constant_Nm_per_A: Annotated[float, Field(strict=True, gt=0)] = 0.6  # noqa: N815
    emulated_current_soft_max_A: Annotated[float, Field(strict=True, gt=0)] = 40.0  # noqa: N815

    @field_validator("endpoints")
    @classmethod
    def _has_what_is_needed(cls, path: str) -> str:
        read_table(path)
        return path

    @property
    def table(self) -> EndpointTable:
        """The parameters of the drive's firmware."""
        return read_table(self.endpoints)

    @property
    def bus_address(self) -> int:
        """The node."""
        return self.node

    @property
    def bus_identifiers(self) -> frozenset[int]:
        """The 32 identifiers of the node."""
        return identifiers_of(self.node)

    @property
    def host_silence_s(self) -> float:
        """Timeout of the drive's watchdog [s]."""
        return 1e-3 * self.watchdog_ms
