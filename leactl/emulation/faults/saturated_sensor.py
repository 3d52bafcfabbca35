"""A sensor whose reading is at the end of its range."""

from collections.abc import Callable, Sequence
from typing import Any, Literal

from pydantic import Field

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Draw, Drill, OfSensor, PlannedBench

BEYOND_ANY_RANGE = 1e6
ENDLESS = ("velocity", "angle")


class SaturatedSensor(OfSensor):
    """A reading is at the end of what the device can tell: an input shorted to its supply, a bridge wire off."""

    example = "{fault: saturated_sensor, at_s: 2, device: torque_sensor, quantity: torque, end: high}"

    end: Literal["high", "low"] = Field("high", description="high or low")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """A torque at the end of its range, and a current."""
        return (
            Drill({"quantity": "torque"}, 0.05, "the converter's saturation"),
            Drill({"quantity": "q_axis_current", "end": "low"}, 0.05, "limit of current_A"),
        )

    def misfits_of(self, planned_bench: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """Reason if the quantity comes from an encoder, which has no range, or if the device does not read it."""
        if self.quantity in ENDLESS:
            return {"quantity": f"{self.quantity} comes from an encoder, which has no end of its range"}
        return super().misfits_of(planned_bench, far_end, quantities)

    def reads(self, draw: Draw) -> Callable[[float], float]:
        """Return a function that gives more than any device can measure; each device then gives its end of range."""
        value = BEYOND_ANY_RANGE if self.end == "high" else -BEYOND_ANY_RANGE
        return lambda _value: value
