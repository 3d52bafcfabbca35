"""A sensor whose reading is in another unit or has another calibration."""

from collections.abc import Callable, Sequence
from typing import Annotated

from pydantic import Field

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Draw, Drill, OfSensor

Factor = Annotated[float, Field(strict=True, ge=-1e6, le=1e6, allow_inf_nan=False)]


class ScaledSensor(OfSensor):
    """A reading is in another unit or by another calibration: milliampere for ampere, kelvin, a swapped amplifier."""

    example = "{fault: scaled_sensor, at_s: 2, device: torque_sensor, quantity: torque, gain: 4}"

    gain: Factor = Field(1.0, description="what the value is multiplied by")
    offset: Factor = Field(0.0, description="what is added then, in the quantity's unit")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """A torque, and a current in milliampere."""
        return (
            Drill({"quantity": "torque", "gain": 4.0}, 0.5, "torque_disagreement"),
            Drill({"quantity": "q_axis_current", "gain": 1000.0}, 0.05, "limit of current_A"),
        )

    def reads(self, draw: Draw) -> Callable[[float], float]:
        """Return a function that converts a value to the wrong scale."""
        return lambda value: self.gain * value + self.offset
