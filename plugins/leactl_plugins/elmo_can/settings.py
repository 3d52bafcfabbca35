"""Settings of one Elmo drive in the bench file."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from leactl.driver.contract import SAFE_STATE_S, DriverSettings
from leactl_plugins.elmo.scales import CurrentConvention

NODES = range(1, 128)  # CiA 301
Node = Annotated[int, Field(strict=True, ge=NODES[0], le=NODES[-1])]


class VoltageObject(BaseModel):
    """The mappable object that holds the q-axis voltage; it differs by firmware, so it is never assumed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    index: Annotated[int, Field(strict=True, ge=0x2000, le=0x9FFF)]
    subindex: Annotated[int, Field(strict=True, ge=0, le=255)] = 0
    type: Literal["i16", "i32"] = "i16"
    scale_V: Annotated[float, Field(strict=True, gt=0)]  # noqa: N815 (a unit keeps its letter)


class ClockObject(BaseModel):
    """The mappable object of 32 bits that holds the drive's own clock in microseconds; never assumed either."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    index: Annotated[int, Field(strict=True, ge=0x2000, le=0x9FFF)]
    subindex: Annotated[int, Field(strict=True, ge=0, le=255)] = 0


def identifiers_of(node: int) -> frozenset[int]:
    """Return the CAN identifiers of network management and SYNC, and those that CiA 301 assigns to a node."""
    return frozenset((0x000, 0x080, *(base + node for base in range(0x080, 0x780, 0x80))))


class ElmoSettings(DriverSettings):
    """Everything that differs from drive to drive; scales come from the drive itself."""

    node: Node
    counts_per_turn: Annotated[int, Field(strict=True, ge=4, le=2**28)]
    sign: Literal[-1, 1] = 1
    current_convention: CurrentConvention = CurrentConvention.AMPLITUDE
    host_node: Node = 126  # Elmo ships drives with 127
    consumer_heartbeat_ms: Annotated[int, Field(strict=True, ge=10, le=round(SAFE_STATE_S * 1000))] = 100
    producer_heartbeat_ms: Annotated[int, Field(strict=True, ge=5, le=5000)] = 50
    abort_option: Literal[1, 2, 3] = 2
    torque_slope_per_mille_s: Annotated[int, Field(strict=True, ge=1, le=2**32 - 1)] | None = None
    q_axis_voltage: VoltageObject | None = None
    drive_clock: ClockObject | None = None
    bus_voltage_period_s: Annotated[float, Field(strict=True, ge=0.05, le=60)] = 0.2
    sdo_timeout_s: Annotated[float, Field(strict=True, gt=0, le=SAFE_STATE_S)] = 0.3
    reset_fault_at_start: bool = False
    # what the emulated drive holds in 0x6075; a real drive's own value is read from it. 13.7 A continuous / sqrt(3/2)
    emulated_rated_current_mA: Annotated[int, Field(strict=True, ge=1, le=1_000_000)] = 11186  # noqa: N815
    vendor_id: int | None = 0x9A

    @property
    def bus_address(self) -> int:
        """Number of the node."""
        return self.node

    @property
    def bus_identifiers(self) -> frozenset[int]:
        """CAN identifiers of network management, SYNC and both heartbeats, and those of the node by CiA 301."""
        return identifiers_of(self.node) | {0x700 + self.host_node}

    @property
    def host_bus_address(self) -> int:
        """The node that the host's heartbeat carries."""
        return self.host_node

    @property
    def host_silence_s(self) -> float:
        """Consumer heartbeat time [s]."""
        return 1e-3 * self.consumer_heartbeat_ms

    @model_validator(mode="after")
    def _nodes_differ(self) -> "ElmoSettings":
        if self.node == self.host_node:
            raise ValueError(f"node and host_node are both {self.node}; the drive and the host need different ones")
        if self.producer_heartbeat_ms >= 5 * self.consumer_heartbeat_ms:
            raise ValueError("producer_heartbeat_ms is far above consumer_heartbeat_ms: a lost drive goes unnoticed")
        return self
