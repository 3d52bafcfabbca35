"""A sensor whose reading stays at one value."""

from collections.abc import Callable, Sequence

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Draw, Drill, OfSensor


class StuckSensor(OfSensor):
    """A reading stays at what it was when the fault began: an amplifier that hangs, firmware that repeats a sample."""

    example = "{fault: stuck_sensor, at_s: 2, device: torque_sensor, quantity: torque}"

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Each reading whose noise makes successive samples differ, and the angle."""
        quantities = ("torque", "q_axis_current", "velocity", "angle")
        return tuple(Drill({"quantity": quantity}, 2.1, "stuck_s") for quantity in quantities)

    def reads(self, draw: Draw) -> Callable[[float], float]:
        """Return a function that repeats the first value."""
        held: list[float] = []

        def hold(value: float) -> float:
            if not held:
                held.append(value)
            return held[0]

        return hold
