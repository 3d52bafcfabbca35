"""What measured temperatures and currents tell the guard: a reading that no actuator of the box can have, heat by DC.

A reading never makes a bound cooler: a camera may have slipped, a thermistor come off. One that is hotter than the
bound shows that the actuator lies outside its tolerances, or that its air is blocked.
"""

from collections.abc import Callable, Iterable
from functools import partial

from leactl.driver.contract import Row, StreamSpec
from leactl.safety.limits import LEADS
from leactl.safety.thermal.bound import HOUSING
from leactl.safety.thermal.guard import ThermalGuard

SENSOR_K = 5.0  # that a camera or a thermistor may read too much


class Leads:
    """Direct currents through leads, by whatever tells one; of several for one role the largest heats."""

    def __init__(self, guard: ThermalGuard) -> None:
        self._guard = guard
        self._told: dict[int, dict[str, float]] = {}  # A^2 by place of the role, and by source

    def tell(self, role: str, source: str, amperes: float) -> None:
        """Have this current [A] flow from now on, as far as this source goes."""
        place = self._guard.roles.index(role)
        told = self._told.setdefault(place, {})
        told[source] = LEADS * amperes * amperes
        self._guard.leads[place] = max(told.values())


class Measured:
    """Streams that measure windings, housings and the current through the leads."""

    def __init__(
        self,
        guard: ThermalGuard,
        streams: Iterable[StreamSpec],
        trip: Callable[[str], object],
        leads: Leads | None = None,
    ) -> None:
        self._guard, self._trip, self._currents = guard, trip, leads or Leads(guard)
        self._looks = {
            stream.name: [
                (place, look, channel.role)
                for place, channel in enumerate(stream.channels)
                if channel.role in guard.roles and (look := self._look_of(channel.quantity, stream.name)) is not None
            ]
            for stream in streams
        }

    def look(self, row: Row) -> None:
        """Hold a row against the guard; a value that is no number is a matter of its age."""
        for place, look, role in self._looks.get(row.stream, ()):
            look(role, row.values[place])

    def _look_of(self, quantity: str, stream: str) -> Callable[[str, float], None] | None:
        looks: dict[str, Callable[[str, float], None]] = {
            "winding_temperature": self._winding,
            "housing_temperature": self._housing,
            "line_current": partial(self._leads, stream),
        }
        return looks.get(quantity)

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

    def _leads(self, stream: str, role: str, reading: float) -> None:
        if reading == reading:
            self._currents.tell(role, stream, reading)
