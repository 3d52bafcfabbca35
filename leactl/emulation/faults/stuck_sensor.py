"""A sensor that goes on telling one value."""

from collections.abc import Callable

from leactl.emulation.faults.contract import Draw, OfSensor


class StuckSensor(OfSensor):
    """A reading stays at what it was when the fault began: an amplifier that hangs, firmware that repeats a sample."""

    example = "{fault: stuck_sensor, at_s: 2, device: torque_sensor, quantity: torque}"

    def reads(self, draw: Draw) -> Callable[[float], float]:
        """The first value, again and again."""
        held: list[float] = []

        def hold(value: float) -> float:
            if not held:
                held.append(value)
            return held[0]

        return hold
