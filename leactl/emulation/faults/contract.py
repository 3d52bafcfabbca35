"""What a fault is: when it begins and how long it lasts, what on the bench it needs, and what it does to it."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol

import numpy as np
from pydantic import Field

from leactl.bench.benchfile import BenchFile, CanBus, CheckedDevice
from leactl.driver import registry
from leactl.driver.far_end import Breakable, CanEmulator, FailingSupply, Frame
from leactl.emulation.clock import EmulatedClock, HostClock
from leactl.emulation.faults.device_readings import STILL, DeviceSignals
from leactl.emulation.plant.parameters import BenchParameters
from leactl.emulation.wires.buses import CanWire, EmulatedI2cBus
from leactl.emulation.wires.serial import SerialWire
from leactl.errors import InputError
from leactl.yamlblock import Block

Positive = Annotated[float, Field(strict=True, gt=0, le=1e6, allow_inf_nan=False)]
Share = Annotated[float, Field(strict=True, gt=0, le=1)]
Direction = Literal["both", "to_devices", "to_host"]
Undo = Callable[[], None]
Draw = np.random.Generator


class FaultTarget(Protocol):
    """What of an emulated bench faults reach."""

    time: EmulatedClock
    host_clock: HostClock
    disk_delay_s: float
    rig: Any
    wires: dict[str, CanWire]
    i2c_buses: dict[str, EmulatedI2cBus]
    serial_wires: dict[str, SerialWire]
    bus_of: dict[str, str]
    far_ends: dict[str, Any]
    signals: dict[str, DeviceSignals]


class PlannedBench(NamedTuple):
    """The bench that a fault is to happen on, before there is one."""

    file: BenchFile
    devices: Mapping[str, CheckedDevice]

    def probe(self, device: str) -> tuple[Any, set[str]]:
        """A device's far end on a bench that stands still, and the quantities it reads there.

        Raises
        ------
        InputError : the device has no emulator.
        """
        entry, signals = self.devices[device].entry, DeviceSignals(STILL)
        far_end = registry.load(entry.driver).far_end(self.devices[device].settings, entry.role, signals)
        return far_end, set(signals.changes)


class Drill(NamedTuple):
    """One rehearsal of a fault, beside when it begins and the device or the bus that it happens to."""

    parameters: Mapping[str, Any]
    within_s: float  # from its beginning to the cycle that ends the run, at the most
    by: str  # what ought to end it
    stays_on: bool = False  # only its supply takes the power from the device


class Fault(Block, ABC):
    """A fault; the first sentence of a subclass says what it is on a real bench, its fields are its parameters."""

    example: ClassVar[str]  # an entry of `emulated: faults:`, on the shipped bench where that has what it needs
    where_served: ClassVar[str] = ""  # why it does nothing on a bench that is served to another process
    not_drilled: ClassVar[str] = ""  # why it is no part of `leactl safety drill`

    fault: str = Field(description="name of the fault")
    at_s: Annotated[float, Field(strict=True, ge=0, le=1e9, allow_inf_nan=False)] = Field(
        description="when it begins, in seconds of the emulated bench's time"
    )

    @classmethod
    def described(cls, name: str) -> dict[str, Any]:
        """What it is, its parameters with what may be left out, and an entry of a bench file."""
        parameters = {
            key: (field.description or "") + ("" if field.is_required() else _unless_given(field.default))
            for key, field in cls.model_fields.items()
            if key != "fault"
        }
        summary = " ".join((cls.__doc__ or "").split())
        return {"fault": name, "summary": summary, "parameters": parameters, "example": cls.example}

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """How it is rehearsed on a bench, on every device or bus that it fits."""
        return ()

    @property
    def ends_s(self) -> float:
        """When it ends [s]; infinity where it does not, or leaves nothing to be ended."""
        return math.inf

    def misfits(self, standing: PlannedBench) -> dict[str, str]:
        """What does not fit this bench, by the parameter that says it."""
        return {}

    @abstractmethod
    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Let it happen; what is returned ends it."""


class LastingFault(Fault):
    """A fault with an end of its own."""

    for_s: Positive | None = Field(None, description="how long it lasts; left out: to the end")

    @property
    def ends_s(self) -> float:
        """When it ends [s]."""
        return math.inf if self.for_s is None else self.at_s + self.for_s


class OfBus(LastingFault):
    """A fault of a CAN bus."""

    bus: str = Field(description="name of the CAN bus")

    def misfits(self, standing: PlannedBench) -> dict[str, str]:
        """A bus that is none, or no CAN bus."""
        buses = [name for name, bus in standing.file.buses.items() if isinstance(bus, CanBus)]
        return {} if self.bus in buses else {"bus": f"'{self.bus}' is no CAN bus of the bench; {_known(buses)}"}


class OfFrames(OfBus):
    """A fault of a share of a bus's frames."""

    share: Share = Field(1.0, description="share of the frames that it happens to, each by chance")
    direction: Direction = Field("both", description="both, to_devices or to_host")

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Stand in the way of every frame."""
        spared = {"both": None, "to_devices": False, "to_host": True}[self.direction]  # whether it comes from a host

        def passes(_frame: Frame, source: CanEmulator | None) -> float | None:
            if (source is None) == spared or draw.random() >= self.share:
                return 0.0
            return self.fate

        return bench.wires[self.bus].disturb(passes)

    @property
    @abstractmethod
    def fate(self) -> float | None:
        """How much later such a frame arrives [s]; None where it never does."""


class OfDevice(Fault):
    """A fault of a device."""

    device: str = Field(description="name of the device")

    def misfits(self, standing: PlannedBench) -> dict[str, str]:
        """A device that is none, or of another kind."""
        if self.device not in standing.devices:
            return {"device": f"'{self.device}' is no device of the bench; {_known(standing.devices)}"}
        try:
            return self.misfits_of(standing, *standing.probe(self.device))
        except InputError as error:
            return {"device": str(error)}

    @abstractmethod
    def misfits_of(self, standing: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """What does not fit this device."""

    def unread(self, quantity: str, quantities: set[str]) -> dict[str, str]:
        """A quantity that the device does not read."""
        text = f"{self.device} reads no {quantity}; {_known(sorted(quantities))}"
        return {} if quantity in quantities else {"quantity": text}


class OfDrive(OfDevice):
    """A fault inside a drive."""

    def misfits_of(self, standing: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """A device whose emulator has no faults of its own."""
        return {} if isinstance(far_end, Breakable) else {"device": f"'{self.device}' is no drive that can fail so"}


class OfPowerSupply(OfDevice, LastingFault):
    """A fault of a device that is a power supply."""

    not_drilled = "no run of the drill switches a power supply on, and one that is off can fail in neither way"

    def misfits_of(self, standing: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """A device whose emulator has no faults of a supply."""
        fails = isinstance(far_end, FailingSupply)
        return {} if fails else {"device": f"'{self.device}' is no power supply that can fail so"}

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Let the supply fail, until it is whole again."""
        supply: FailingSupply = bench.far_ends[self.device]
        self.strike(supply)
        return supply.mend

    @abstractmethod
    def strike(self, supply: FailingSupply) -> None:
        """What happens to it."""


class OfSensor(OfDevice, LastingFault):
    """A fault of one reading of a device; the machine and the drive's own loops go on with the true value."""

    quantity: str = Field(description="what the device reads: torque, q_axis_current, velocity, angle, bus_voltage")

    def misfits_of(self, standing: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """A quantity that the device does not read."""
        return self.unread(self.quantity, quantities)

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Stand between the physics and the device."""
        return bench.signals[self.device].change(self.quantity, self.reads(draw))

    @abstractmethod
    def reads(self, draw: Draw) -> Callable[[float], float]:
        """What the sensor makes of a value."""


class OfSupply(LastingFault):
    """A fault of the supply's voltage."""

    bus_voltage_V: Positive = Field(description="DC link voltage meanwhile")  # noqa: N815 (a unit keeps its letter)

    def misfits(self, standing: PlannedBench) -> dict[str, str]:
        """A voltage on the wrong side of the bench's own."""
        given = standing.file.emulated.bench if standing.file.emulated else {}
        usual = BenchParameters.from_mapping(given).bus_voltage
        text = self.misfit_of(usual)
        return {"bus_voltage_V": f"{self.bus_voltage_V:g} V is not {text} the bench's {usual:g} V"} if text else {}

    @abstractmethod
    def misfit_of(self, usual: float) -> str:
        """The side of the bench's voltage that was expected, where this one is not there."""

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Put the voltage there."""
        usual = bench.rig.bench.bus_voltage
        bench.rig.supply(self.bus_voltage_V)
        return lambda: bench.rig.supply(usual)


def _known(names: Any) -> str:
    return f"it has {', '.join(names) or 'none'}"


def _unless_given(default: Any) -> str:
    return "" if default is None else f" (default {str(default).lower()})"
