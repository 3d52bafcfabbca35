"""Comparison of measured temperatures, resistances and currents with the bounds of the thermal guard.

A reading never makes a bound cooler: a camera may have slipped, a thermistor come off. A reading that is hotter than
the bound shows that the actuator lies outside its tolerances, or that its air is blocked.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import partial

from leactl.driver.contract import Row, SampleBlock, StreamSpec
from leactl.safety.limits import LEADS
from leactl.safety.thermal.guard import ThermalGuard
from leactl.safety.thermal.resistance import ResistanceThermometer
from leactl.safety.thermal.temperature_bound import HOUSING

SENSOR_ERROR_K = 5.0  # a camera or a thermistor may read too high by as much


class Leads:
    """Direct currents through the leads of each role; if several sources report one role, the largest counts."""

    def __init__(self, guard: ThermalGuard) -> None:
        self._guard = guard
        self._squares: dict[int, dict[str, float]] = {}  # A^2 by index of the role, and by source

    def tell(self, role: str, source: str, amperes: float) -> None:
        """Set the current [A] through the leads of a role that a source, the name of a stream, reports from now on."""
        index = self._guard.roles.index(role)
        squares = self._squares.setdefault(index, {})
        squares[source] = LEADS * amperes * amperes
        self._guard.leads[index] = max(squares.values())


class MeasuredStreams:
    """Streams that measure temperatures of windings, housings and air, or current and voltage of the leads.

    It calls `trip` on a reading that no actuator within the guard's boxes can have.
    """

    def __init__(
        self,
        guard: ThermalGuard,
        streams: Iterable[StreamSpec],
        trip: Callable[[str], object],
        leads: Leads | None = None,
    ) -> None:
        self._guard, self._trip, self._leads = guard, trip, leads or Leads(guard)
        self._comparisons = {
            stream.name: comparisons for stream in streams if (comparisons := list(self._comparisons_of(stream)))
        }

    @property
    def streams(self) -> frozenset[str]:
        """Names of the streams that measure anything for the guard."""
        return frozenset(self._comparisons)

    def look(self, row: Row) -> None:
        """Compare a row with the guard's bounds; a value that is NaN passes, since its age is checked elsewhere.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        for compare in self._comparisons.get(row.stream, ()):
            compare(row)

    def look_through(self, block: SampleBlock) -> None:
        """Compare the rows of a block with the guard's bounds if their stream measures anything for the guard.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        if block.stream in self._comparisons:
            for row in block.rows():
                self.look(row)

    def _comparisons_of(self, stream: StreamSpec) -> Iterator[Callable[[Row], None]]:
        """Yield a function for each comparison that the channels of a stream allow."""
        compare_by_quantity = {
            "winding_temperature": self._compare_winding,
            "housing_temperature": self._compare_housing,
            "line_current": self._set_lead_current,
        }
        indices = {(channel.role, channel.quantity): index for index, channel in enumerate(stream.channels)}
        for (_role, quantity), index in indices.items():
            if quantity == "ambient_temperature":
                yield partial(self._compare_air, index)
        for (role, quantity), index in indices.items():
            if role in self._guard.roles and quantity in compare_by_quantity:
                yield partial(compare_by_quantity[quantity], role, index)
        for role in self._guard.roles:
            voltage, current = indices.get((role, "line_voltage")), indices.get((role, "line_current"))
            if voltage is not None and current is not None:
                yield partial(
                    self._compare_resistance, role, voltage, current, ResistanceThermometer(self._guard.boxes[role])
                )

    def _compare_air(self, index: int, row: Row) -> None:
        """Trip if the air is measured hotter than the bench file's ambient, its tolerance and the sensor allow."""
        ambient = self._guard.ambient
        highest_expected = ambient + min(box.ambient_rise for box in self._guard.boxes.values()) + SENSOR_ERROR_K
        if row.values[index] > highest_expected:
            self._trip(
                f"the air is measured at {row.values[index]:.1f} degC; {highest_expected:.1f} degC at the most was"
                f" expected where the bench file tells {ambient:g} degC: correct its ambient_temperature_degC"
            )

    def _compare_winding(self, role: str, index: int, row: Row) -> None:
        """Trip if the winding is measured hotter than its hottest phase can be."""
        self._compare(role, "winding is measured", row.values[index], self._guard.hottest[role])

    def _compare_housing(self, role: str, index: int, row: Row) -> None:
        """Trip if the housing is measured hotter than it can be."""
        self._compare(role, "housing is measured", row.values[index], float(self._guard.node_bounds[role][HOUSING]))

    def _compare_resistance(
        self, role: str, voltage: int, current: int, thermometer: ResistanceThermometer, row: Row
    ) -> None:
        """Trip if the winding is by its resistance hotter than its hottest phase can be.

        voltage, current : indices of the two among the values of a row.
        """
        lowest_temperature = thermometer.lowest_temperature(row.values[voltage], row.values[current], row.time)
        self._compare(role, "winding is by its resistance", lowest_temperature, self._guard.hottest[role])

    def _compare(self, role: str, measured_part: str, reading: float, bound: float) -> None:
        """Trip if a temperature [degC] is further above its bound [degC] than a sensor's error explains."""
        if reading > bound + SENSOR_ERROR_K:
            self._trip(
                f"{role} {measured_part} at {reading:.1f} degC, and no actuator inside its motor file's tolerances"
                f" can be above {bound:.1f} degC: cooling, tolerances or sensor are not what they are taken to be"
            )

    def _set_lead_current(self, role: str, index: int, row: Row) -> None:
        """Set the current through the leads of a role to its reading, unless that is NaN."""
        reading = row.values[index]
        if reading == reading:
            self._leads.tell(role, row.stream, reading)
