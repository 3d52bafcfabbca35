"""Settings of one moteus controller; scales and limits come from the controller itself."""

from typing import Annotated, Literal

from pydantic import Field

from leactl.driver.contract import SAFE_STATE_S, DriverSettings
from leactl_plugins.moteus_can.multiplex import REPLY_REQUESTED, identifier

NODES = range(1, 127)  # ids of controllers; 127 addresses all of them
HOST = 0  # the source of the host's frames, as the maker's programs have it


class MoteusSettings(DriverSettings):
    """Everything that differs from drive to drive."""

    node: Annotated[int, Field(strict=True, ge=NODES[0], le=NODES[-1])]
    sign: Literal[-1, 1] = 1
    watchdog_ms: Annotated[int, Field(strict=True, ge=10, le=round(SAFE_STATE_S * 1000))] = 100
    supply_period_s: Annotated[float, Field(strict=True, ge=0.05, le=60)] = 0.2
    answer_timeout_s: Annotated[float, Field(strict=True, gt=0, le=SAFE_STATE_S)] = 0.1
    reset_fault_at_start: bool = False
    # if they are given, a controller with other values is refused
    torque_constant_Nm_per_A: Annotated[float, Field(strict=True, gt=0)] | None = None  # noqa: N815
    max_current_A: Annotated[float, Field(strict=True, gt=0)] | None = None  # noqa: N815

    @property
    def bus_address(self) -> int:
        """The node."""
        return self.node

    @property
    def bus_identifiers(self) -> frozenset[int]:
        """Identifiers of the host's frames, with and without a requested answer, and of the controller's."""
        return frozenset(
            (identifier(HOST, self.node), identifier(HOST | REPLY_REQUESTED, self.node), identifier(self.node, HOST))
        )

    @property
    def host_silence_s(self) -> float:
        """Time for which a command is valid [s]."""
        return 1e-3 * self.watchdog_ms
