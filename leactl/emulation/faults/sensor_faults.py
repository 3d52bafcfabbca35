"""Sensors that are unplugged, stuck, noisy, saturated or of another scale."""

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from leactl.bench.benchfile import BenchFile, I2cBus
from leactl.emulation.faults.contract import (
    Draw,
    Drill,
    FaultTarget,
    LastingFault,
    OfDevice,
    OfSensor,
    PlannedBench,
    Positive,
    Undo,
)
from leactl.quantities import UNITS


class DisconnectedSensor(OfDevice, LastingFault):
    """A plug is out: of the sensor, whose reading is zero then, or of the whole converter, which answers no more."""

    fault_name = "disconnected_sensor"
    example = "{fault: disconnected_sensor, at_s: 2, device: torque_sensor, quantity: torque}"

    quantity: str | None = Field(
        None, description="the reading whose sensor is unplugged; left out: the device itself, where its bus is I2C"
    )

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return three rehearsals: a converter, the torque sensor at a converter, and the current sensor of a drive."""
        return (
            Drill({}, 0.05, "the device's own bus"),
            Drill({"quantity": "torque"}, 2.1, "stuck_s or torque_disagreement"),
            Drill({"quantity": "q_axis_current"}, 2.1, "current_disagreement or stuck_s"),
        )

    def misfits_of(self, planned_bench: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """Return the reason if the device does not read the quantity, or if none is set and its bus is not I2C."""
        if self.quantity is None:
            bus = planned_bench.file.buses.get(planned_bench.devices[self.device].entry.bus or "")
            reason = f"'{self.device}' is not on an I2C bus; name the quantity whose sensor is off, or use lost_frames"
            return {} if isinstance(bus, I2cBus) else {"device": reason}
        return self.misfit_if_unread(self.quantity, quantities)

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Set the reading to zero, or silence the device; return a function that ends it."""
        if self.quantity is not None:
            return bench.signals[self.device].change(self.quantity, lambda _value: 0.0)
        silent, far_end = bench.i2c_buses[bench.bus_of[self.device]].silent, bench.far_ends[self.device]
        silent.append(far_end)
        return lambda: silent.remove(far_end)


class StuckSensor(OfSensor):
    """A reading stays at what it was when the fault began: an amplifier that hangs, firmware that repeats a sample."""

    fault_name = "stuck_sensor"
    example = "{fault: stuck_sensor, at_s: 2, device: torque_sensor, quantity: torque}"

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return a rehearsal for the angle, and for each reading whose noise makes successive samples differ."""
        quantities = ("torque", "q_axis_current", "velocity", "angle")
        return tuple(Drill({"quantity": quantity}, 2.1, "stuck_s") for quantity in quantities)

    def faulty_reading(self, draw: Draw) -> Callable[[float], float]:
        """Return a function that repeats the first value."""
        first_values: list[float] = []

        def first_value(value: float) -> float:
            if not first_values:
                first_values.append(value)
            return first_values[0]

        return first_value


class NoisySensor(OfSensor):
    """A reading carries normal noise of a given spread: a broken shield, a loose plug, a worn slip ring."""

    fault_name = "noisy_sensor"
    example = "{fault: noisy_sensor, at_s: 2, device: torque_sensor, quantity: torque, spread: 6, unit: N*m}"

    spread: Positive = Field(description="standard deviation of the noise, in the unit given")
    unit: str = Field(description="unit of the spread, which is the quantity's own")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return one rehearsal: torque noise as large as the limit, which one sample in three then exceeds."""
        spread = file.limits.torque_Nm
        return (Drill({"quantity": "torque", "spread": spread, "unit": "N*m"}, 0.5, "limit of torque_Nm"),)

    def misfits(self, planned_bench: PlannedBench) -> dict[str, str]:
        """Return the reasons of any sensor fault, and the reason if the unit is not the quantity's."""
        reasons, expected_unit = super().misfits(planned_bench), UNITS.get(self.quantity, self.unit)
        return (
            reasons
            if self.unit == expected_unit
            else reasons | {"unit": f"{self.quantity} is in {expected_unit}, not in {self.unit}"}
        )

    def faulty_reading(self, draw: Draw) -> Callable[[float], float]:
        """Return a function that adds normal noise to a value."""
        return lambda value: value + self.spread * float(draw.standard_normal())


OUT_OF_EVERY_RANGE = 1e6  # in any unit, above the range of every device
UNBOUNDED_QUANTITIES = ("velocity", "angle")  # read by encoders


class SaturatedSensor(OfSensor):
    """A reading is at the end of what the device can tell: an input shorted to its supply, a bridge wire off."""

    fault_name = "saturated_sensor"
    example = "{fault: saturated_sensor, at_s: 2, device: torque_sensor, quantity: torque, end: high}"

    end: Literal["high", "low"] = Field("high", description="high or low")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return two rehearsals: a torque and a current at the end of their ranges."""
        return (
            Drill({"quantity": "torque"}, 0.05, "the converter's saturation"),
            Drill({"quantity": "q_axis_current", "end": "low"}, 0.05, "limit of current_A"),
        )

    def misfits_of(self, planned_bench: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """Return the reason if the quantity is an encoder's, which has no range, or if the device does not read it."""
        if self.quantity in UNBOUNDED_QUANTITIES:
            return {"quantity": f"{self.quantity} comes from an encoder, which has no end of its range"}
        return super().misfits_of(planned_bench, far_end, quantities)

    def faulty_reading(self, draw: Draw) -> Callable[[float], float]:
        """Return a function that gives more than any device can measure; each device then gives its end of range."""
        value = OUT_OF_EVERY_RANGE if self.end == "high" else -OUT_OF_EVERY_RANGE
        return lambda _value: value


Factor = Annotated[float, Field(strict=True, ge=-1e6, le=1e6, allow_inf_nan=False)]


class ScaledSensor(OfSensor):
    """A reading is in another unit or by another calibration: milliampere for ampere, kelvin, a swapped amplifier."""

    fault_name = "scaled_sensor"
    example = "{fault: scaled_sensor, at_s: 2, device: torque_sensor, quantity: torque, gain: 4}"

    gain: Factor = Field(1.0, description="what the value is multiplied by")
    offset: Factor = Field(0.0, description="what is added then, in the quantity's unit")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return two rehearsals: a torque times four, and a current in milliampere."""
        return (
            Drill({"quantity": "torque", "gain": 4.0}, 0.5, "torque_disagreement"),
            Drill({"quantity": "q_axis_current", "gain": 1000.0}, 0.05, "limit of current_A"),
        )

    def faulty_reading(self, draw: Draw) -> Callable[[float], float]:
        """Return a function that converts a value to the wrong scale."""
        return lambda value: self.gain * value + self.offset
