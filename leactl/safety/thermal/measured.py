"""What measured temperatures and currents tell the guard: a reading that no actuator of the box can have, heat by DC.

A reading never makes a bound cooler: a camera may have slipped, a thermistor come off. One that is hotter than the
bound shows that the actuator lies outside its tolerances, or that its air is blocked.
"""

from collections.abc import Callable, Iterable

from leactl.driver.contract import Block, Row, StreamSpec
from leactl.safety.thermal.bound import HOUSING
from leactl.safety.thermal.guard import ThermalGuard

SENSOR_K = 5.0  # that a camera or a thermistor may read too much
LEADS = 2.0  # mean square current of the q axis that heats like a direct current through two leads, over its square


class Measured:
    """Streams that measure windings, housings and the current through the leads."""

    def __init__(self, guard: ThermalGuard, streams: Iterable[StreamSpec], trip: Callable[[str], object]) -> None:
        self._guard, self._trip = guard, trip
        self._looks = {
            stream.name: [
                (place, look, channel.role)
                for place, channel in enumerate(stream.channels)
                if channel.role in guard.roles and (look := self._look_of(channel.quantity)) is not None
            ]
            for stream in streams
        }

    def look(self, row: Row) -> None:
        """Hold a row against the guard; a value that is no number is a matter of its age."""
        for place, look, role in self._looks.get(row.stream, ()):
            look(role, row.values[place])

    def look_through(self, block: Block) -> None:
        """Hold many rows against the guard, where their stream measures anything for it."""
        if self._looks.get(block.stream):
            for row in block.rows():
                self.look(row)

    def _look_of(self, quantity: str) -> Callable[[str, float], None] | None:
        return {
            "winding_temperature": self._winding,
            "housing_temperature": self._housing,
            "line_current": self._leads,
        }.get(quantity)

    def _winding(self, role: str, reading: float) -> None:
        self._compare(role, "winding", reading, self._guard.hottest[role])

    def _housing(self, role: str, reading: float) -> None:
        self._compare(role, "housing", reading, float(self._guard.kept[role][HOUSING]))

    def _compare(self, role: str, part: str, reading: float, bound: float) -> None:
        if reading > bound + SENSOR_K:
            self._trip(
                f"{role} {part} is measured at {reading:.1f} degC, and no actuator inside its motor file's tolerances"
                f" can be above {bound:.1f} degC: cooling, tolerances or sensor are not what they are taken to be"
            )

    def _leads(self, role: str, reading: float) -> None:
        if reading == reading:
            self._guard.leads[self._guard.roles.index(role)] = LEADS * reading * reading
