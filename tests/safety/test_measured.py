"""Measured temperatures and lead currents against the guard."""

import numpy as np
import pytest

from leactl.driver.contract import Row, StreamSpec
from leactl.errors import SafetyTrip
from leactl.quantities import ChannelSpec
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.guard import ThermalGuard
from leactl.safety.thermal.measured import MeasuredStreams
from leactl.safety.thermal.resistance import ResistanceThermometer
from tests.safety.guards import LEA, SETTINGS, guard_of

CHANNELS = ("winding_temperature", "housing_temperature", "line_current")
STREAM = StreamSpec("camera", tuple(ChannelSpec(name, name, "test", "camera") for name in CHANNELS))


def tripped(cause):
    raise SafetyTrip(cause)


def measured(guard):
    return MeasuredStreams(guard, [STREAM], tripped)


@pytest.mark.parametrize(
    ("values", "cause"),
    [
        ((60.0, 30.0, 0.0), r"test winding is measured at 60\.0 degC, and no actuator .* can be above 28\.0 degC"),
        ((30.0, 45.0, 0.0), r"test housing is measured at 45\.0 degC"),
        ((297.0, 296.0, 0.0), "test winding is measured"),
    ],
)
def test_a_reading_hotter_than_any_actuator_can_be_trips(values, cause):
    with pytest.raises(SafetyTrip, match=cause):
        measured(guard_of()).look(Row("camera", 0.0, values))


@pytest.mark.parametrize("values", [(32.0, 31.0, 0.0), (-20.0, 0.0, 0.0), (np.nan, np.nan, np.nan)])
def test_a_reading_makes_no_bound_cooler_and_none_trips_below_it(values):
    guard = guard_of()
    guard.begin(0.0)
    measured(guard).look(Row("camera", 0.0, values))
    assert guard.check(0.5) == ""
    assert guard.hottest["test"] == pytest.approx(28.0, abs=0.01)


AIR = StreamSpec("room", (ChannelSpec("air", "ambient_temperature", "bench", "room"),))


def test_air_that_is_hotter_than_the_bench_file_tells_trips():
    look = MeasuredStreams(guard_of(), [AIR], tripped)
    for reading in (25.0, 32.9, -10.0, np.nan):  # 25 degC are told, 3 K allowed, and 5 K of the sensor
        look.look(Row("room", 0.0, (reading,)))
    told = r"the air is measured at 33\.1 degC; 33\.0 degC at the most was expected where the bench file tells 25 degC"
    with pytest.raises(SafetyTrip, match=told):
        look.look(Row("room", 0.1, (33.1,)))


def test_air_that_is_too_hot_for_one_of_two_actuators_trips():
    narrow = LEA.model_copy(update={"tolerances": LEA.tolerances.model_copy(update={"ambient_K": 1.0})})
    start = {role: np.full(3, 26.0) for role in ("test", "load")}
    look = MeasuredStreams(ThermalGuard({"test": LEA, "load": narrow}, SETTINGS, start), [AIR], tripped)
    look.look(Row("room", 0.0, (30.9,)))
    with pytest.raises(SafetyTrip, match=r"31\.1 degC; 31\.0 degC at the most was expected"):
        look.look(Row("room", 0.1, (31.1,)))


def test_a_resistance_is_told_once_it_has_lasted_a_second():
    thermometer = ResistanceThermometer(Box.of(LEA))
    told = [
        thermometer.lowest_temperature(9.0 * lead_resistance(130.0), 9.0, now) for now in (0.0, 0.5, 0.75, 1.0, 1.25)
    ]
    assert [value == value for value in told] == [False, False, False, True, False]


PAIR = StreamSpec("supply", tuple(ChannelSpec(n, n, "test", "supply") for n in ("line_voltage", "line_current")))


def looked(resistances, currents, bound=28.0):
    """Rows at 10 Hz of a winding with these resistances from lead to lead."""
    look = MeasuredStreams(guard_of(start=bound), [PAIR], tripped)
    for k, (resistance, current) in enumerate(zip(resistances, currents, strict=True)):
        look.look(Row("supply", 0.1 * k, (resistance * current, current)))


def lead_resistance(celsius, above=1.0):
    """Of the LEA at a temperature, times what its tolerance adds."""
    return 0.528 * above * (1.0 + 0.004 * (celsius - 25.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_resistance_that_no_cooler_winding_can_have_trips(sign):
    with pytest.raises(SafetyTrip, match=r"test winding is by its resistance at 9\d\.\d degC, and no actuator"):
        looked([lead_resistance(130.0)] * 30, [9.0 * sign] * 30)


@pytest.mark.parametrize(
    ("resistance", "current", "bound"),
    [
        (lead_resistance(45.0), 9.0, 28.0),  # within the tolerance of a cold one
        (lead_resistance(100.0, above=1.1), 9.0, 100.0),
        (lead_resistance(130.0), 0.5, 28.0),  # an offset would do as much
        (np.nan, 9.0, 28.0),
    ],
)
def test_a_resistance_that_a_winding_of_the_box_may_have_does_not(resistance, current, bound):
    looked([resistance] * 30, [current] * 30, bound)


def test_a_voltage_that_is_read_before_its_current_is_no_resistance():
    looked([lead_resistance(25.0), lead_resistance(200.0)] * 20, [9.0] * 40)


def test_a_direct_current_through_two_leads_heats_as_both_phases_do():
    guard = guard_of()
    guard.begin(0.0)
    look = measured(guard)
    for step in range(1, 1201):
        look.look(Row("camera", step / 20, (np.nan, np.nan, 9.0)))
        assert guard.check(step / 20) == ""
    # two phases take R i^2 each: 21.4 W at 25 degC, twice what a phase of a third has at its mean share of 2 R i^2
    assert 55.0 < guard.hottest["test"] < 85.0
