"""Base classes of faults: when a fault begins, how long it lasts, what it needs on the bench, and what it changes."""

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
    """The parts of an emulated bench that faults can change."""

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
    """A bench file and its devices, to check that a fault fits before the bench is made."""

    file: BenchFile
    devices: Mapping[str, CheckedDevice]

    def probe(self, device: str) -> tuple[Any, set[str]]:
        """Make the device's emulator on a motionless bench; return it and the quantities that it reads.

        Raises
        ------
        InputError : the device has no emulator.
        """
        entry, signals = self.devices[device].entry, DeviceSignals(STILL)
        far_end = registry.load(entry.driver).far_end(self.devices[device].settings, entry.role, signals)
        return far_end, set(signals.changes)


class Drill(NamedTuple):
    """One rehearsal of a fault: its parameters without time, device and bus, and the expected end of the run."""

    parameters: Mapping[str, Any]
    within_s: float  # longest time from the beginning of the fault to the cycle that ends the run
    ended_by: str  # what has to end the run
    stays_on: bool = False  # the device keeps its power until its supply is switched off


class Fault(Block, ABC):
    """A fault; the first sentence of a subclass says what it is on a real bench, its fields are its parameters."""

    fault_name: ClassVar[str]  # its name in bench files: `fault: NAME`
    example: ClassVar[str]  # an entry of `emulated: faults:`, if possible for the shipped bench
    inactive_when_served: ClassVar[str] = ""  # why the fault does nothing on a bench that is served to another process
    not_drilled: ClassVar[str] = ""  # why the fault is no part of `leactl safety drill`

    fault: str = Field(description="name of the fault")
    at_s: Annotated[float, Field(strict=True, ge=0, le=1e9, allow_inf_nan=False)] = Field(
        description="when it begins, in seconds of the emulated bench's time"
    )

    @classmethod
    def described(cls, name: str) -> dict[str, Any]:
        """Return a description for a user: summary, parameters with defaults, and an example entry of a bench file."""
        parameters = {
            key: (field.description or "") + ("" if field.is_required() else _unless_given(field.default))
            for key, field in cls.model_fields.items()
            if key != "fault"
        }
        summary = " ".join((cls.__doc__ or "").split())
        return {"fault": name, "summary": summary, "parameters": parameters, "example": cls.example}

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return the rehearsals of the fault on a bench; each is made on every device or bus that it fits."""
        return ()

    @property
    def ends_s(self) -> float:
        """Time [s] at which the fault ends; infinity if it lasts to the end, or if nothing has to be undone."""
        return math.inf

    def misfits(self, planned_bench: PlannedBench) -> dict[str, str]:
        """Return the reason by parameter for each parameter that does not fit the bench; empty if all fit."""
        return {}

    @abstractmethod
    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Start the fault; return a function that ends it."""


class LastingFault(Fault):
    """A fault that may end before the run does."""

    for_s: Positive | None = Field(None, description="how long it lasts; left out: to the end")

    @property
    def ends_s(self) -> float:
        """Time [s] at which the fault ends; infinity if `for_s` is not set."""
        return math.inf if self.for_s is None else self.at_s + self.for_s


class OfBus(LastingFault):
    """A fault of a CAN bus."""

    bus: str = Field(description="name of the CAN bus")

    def misfits(self, planned_bench: PlannedBench) -> dict[str, str]:
        """Return the reason if `bus` is not the name of a CAN bus."""
        bus_names = [name for name, bus in planned_bench.file.buses.items() if isinstance(bus, CanBus)]
        return {} if self.bus in bus_names else {"bus": f"'{self.bus}' is no CAN bus of the bench; {_known(bus_names)}"}


class OfFrames(OfBus):
    """A fault of a share of the frames on a bus."""

    share: Share = Field(1.0, description="share of the frames that it happens to, each by chance")
    direction: Direction = Field("both", description="both, to_devices or to_host")

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Apply the fault to frames of the direction with the probability `share`; return a function that ends it."""
        # True: frames from a host are not affected; False: those of devices; None: all are
        spared_source = {"both": None, "to_devices": False, "to_host": True}[self.direction]

        def delay_of_frame(_frame: Frame, source: CanEmulator | None) -> float | None:
            if (source is None) == spared_source or draw.random() >= self.share:
                return 0.0
            return self.frame_delay

        return bench.wires[self.bus].disturb(delay_of_frame)

    @property
    @abstractmethod
    def frame_delay(self) -> float | None:
        """Delay of an affected frame [s]; None if it never arrives."""


class OfDevice(Fault):
    """A fault of a device."""

    device: str = Field(description="name of the device")

    def misfits(self, planned_bench: PlannedBench) -> dict[str, str]:
        """Return the reason if `device` is not a device of the bench, or is of another kind than the fault needs."""
        if self.device not in planned_bench.devices:
            return {"device": f"'{self.device}' is no device of the bench; {_known(planned_bench.devices)}"}
        try:
            return self.misfits_of(planned_bench, *planned_bench.probe(self.device))
        except InputError as error:
            return {"device": str(error)}

    @abstractmethod
    def misfits_of(self, planned_bench: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """Return the reason by parameter for each parameter that does not fit this device; empty if all fit."""

    def misfit_if_unread(self, quantity: str, quantities: set[str]) -> dict[str, str]:
        """Return the reason if the device does not read the quantity."""
        reason = f"{self.device} reads no {quantity}; {_known(sorted(quantities))}"
        return {} if quantity in quantities else {"quantity": reason}


class OfDrive(OfDevice):
    """A fault inside a drive."""

    def misfits_of(self, planned_bench: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """Return the reason if the device's emulator is not a drive that can fail."""
        return {} if isinstance(far_end, Breakable) else {"device": f"'{self.device}' is no drive that can fail so"}


class OfPowerSupply(OfDevice, LastingFault):
    """A fault of a device that is a power supply."""

    not_drilled = "no run of the drill switches a power supply on, and one that is off can fail in neither way"

    def misfits_of(self, planned_bench: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """Return the reason if the device's emulator is not a supply that can fail."""
        can_fail = isinstance(far_end, FailingSupply)
        return {} if can_fail else {"device": f"'{self.device}' is no power supply that can fail so"}

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Start the supply's failure; return a function that ends it."""
        supply: FailingSupply = bench.far_ends[self.device]
        self.strike(supply)
        return supply.mend

    @abstractmethod
    def strike(self, supply: FailingSupply) -> None:
        """Make the supply's emulator fail."""


class OfSensor(OfDevice, LastingFault):
    """A fault of one reading of a device; the machine and the drive's own loops go on with the true value."""

    quantity: str = Field(description="what the device reads: torque, q_axis_current, velocity, angle, bus_voltage")

    def misfits_of(self, planned_bench: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """Return the reason if the device does not read the quantity."""
        return self.misfit_if_unread(self.quantity, quantities)

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Change the reading between the plant and the device; return a function that ends the change."""
        return bench.signals[self.device].change(self.quantity, self.faulty_reading(draw))

    @abstractmethod
    def faulty_reading(self, draw: Draw) -> Callable[[float], float]:
        """Return a function that converts a true value to the faulty reading."""


class OfSupply(LastingFault):
    """A fault of the supply's voltage."""

    bus_voltage_V: Positive = Field(description="DC link voltage meanwhile")  # noqa: N815 (a unit keeps its letter)

    def misfits(self, planned_bench: PlannedBench) -> dict[str, str]:
        """Return the reason if the voltage is not on the required side of the bench's nominal voltage."""
        parameters = planned_bench.file.emulated.bench if planned_bench.file.emulated else {}
        nominal_voltage = BenchParameters.from_mapping(parameters).bus_voltage
        required_side = self.misfit_of(nominal_voltage)
        return (
            {"bus_voltage_V": f"{self.bus_voltage_V:g} V is not {required_side} the bench's {nominal_voltage:g} V"}
            if required_side
            else {}
        )

    @abstractmethod
    def misfit_of(self, nominal_voltage: float) -> str:
        """Return the word for the required side of the nominal voltage [V] if the fault's is not there; else empty."""

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Set the DC link voltage; return a function that sets the previous one again."""
        previous_voltage = bench.rig.bench.bus_voltage
        bench.rig.supply(self.bus_voltage_V)
        return lambda: bench.rig.supply(previous_voltage)


def _known(names: Any) -> str:
    """Return the text that lists what the bench or device has."""
    return f"it has {', '.join(names) or 'none'}"


def _unless_given(default: Any) -> str:
    """Return the text of a parameter's default; empty if it is None."""
    return "" if default is None else f" (default {str(default).lower()})"
