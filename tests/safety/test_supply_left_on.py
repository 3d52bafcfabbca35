"""What two leads carry for ever, and where a supply's protection ends it: held against actuators that are stepped."""

import math

import numpy as np
import pytest

from leactl.driver.contract import TripAccuracy
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.supply_left_on import (
    VOLTAGE_ERROR_SHARE,
    VOLTAGE_ERROR_V,
    endurance,
    temperature_reached,
    trip_level,
)
from tests.safety.guards import LEA
from tests.safety.heated_leads import HeatedActuators

LIMIT, MARGIN, AMBIENT = 130.0, 0.5, 25.0
FOR_EVER_S = 9000.0  # nine time constants of the housing
COLD = (28.0, 28.0, 28.0)
BOX = Box.of(LEA)
CARRIED = endurance(BOX, LIMIT - MARGIN, AMBIENT)
PROTECTION = TripAccuracy(0.01, 0.51)


@pytest.fixture(scope="module")
def actuators():
    return HeatedActuators(LEA, AMBIENT, np.random.default_rng(5))


def given(voltage):
    return voltage * (1.0 + VOLTAGE_ERROR_SHARE) + VOLTAGE_ERROR_V


@pytest.mark.parametrize(
    ("voltage", "current", "least"),
    [
        (20.0, CARRIED.current, 123.0),
        *((CARRIED.highest_voltage(amperes), amperes, 85.0) for amperes in (8.5, 9.0, 10.0, 14.0)),
    ],
)
def test_levels_that_are_outlived_burn_no_actuator(actuators, voltage, current, least):
    assert CARRIED.outlives(voltage, current, COLD)
    actuators.begin([28.0] * 3, 28.0)
    hottest, _ = actuators.leave_on(given(voltage), current, FOR_EVER_S)
    assert least < hottest.max() < LIMIT
    assert not CARRIED.outlives(voltage + 0.01, current + 0.01, COLD)


def test_heat_that_is_outlived_burns_no_actuator_whatever_its_resistance(actuators):
    actuators.begin([28.0] * 3, 28.0)
    hottest, _ = actuators.leave_on(
        0.0, 0.0, FOR_EVER_S, watts=given(CARRIED.highest_voltage(9.0)) * BOX.current_gain * 9.0
    )
    assert LIMIT - 6.0 < hottest.max() < LIMIT


@pytest.mark.parametrize("voltage", [2.0, 5.0, 5.7, 8.0])
def test_the_most_beside_a_voltage_is_outlived_and_no_more_is(voltage):
    most, cold = CARRIED.highest_current(voltage), [25.0] * 3
    assert CARRIED.outlives(voltage, min(most, 1e6) * (1.0 - 1e-9), cold)
    assert math.isinf(most) or not CARRIED.outlives(voltage, most * (1.0 + 1e-9), cold)


def test_a_voltage_that_holds_the_heat_down_by_itself_leaves_any_current():
    assert math.isinf(CARRIED.highest_current(2.0))
    assert CARRIED.highest_current(8.0) == CARRIED.current


@pytest.mark.parametrize("current", [CARRIED.current, 9.0, 14.0])
def test_a_winding_that_begins_at_the_ceiling_stays_below_the_limit(actuators, current):
    hottest, mean, housing = CARRIED.start_ceilings
    voltage = 20.0 if current == CARRIED.current else CARRIED.highest_voltage(current)
    for phases in ([mean] * 3, [hottest, hottest, 3 * mean - 2 * hottest], [2 * mean - hottest, mean, hottest]):
        actuators.begin(phases, housing)
        assert actuators.leave_on(given(voltage), current, FOR_EVER_S)[0].max() < LIMIT


@pytest.mark.parametrize("node", range(3))
def test_a_winding_that_begins_above_the_ceiling_outlives_nothing(node):
    start = [ceiling - 0.1 for ceiling in CARRIED.start_ceilings]
    assert CARRIED.outlives(8.0, 2.0, start)
    start[node] += 0.2
    assert not CARRIED.outlives(8.0, 2.0, start)


def test_what_is_reached_is_at_the_limit_where_levels_are_just_outlived():
    assert temperature_reached(BOX, AMBIENT, 20.0, CARRIED.current) == pytest.approx(LIMIT - MARGIN, abs=0.01)
    assert temperature_reached(BOX, AMBIENT, CARRIED.highest_voltage(9.0), 9.0) == pytest.approx(
        LIMIT - MARGIN, abs=2.0
    )
    assert temperature_reached(BOX, AMBIENT, 8.0, 9.0) > LIMIT + 30.0
    assert temperature_reached(BOX, AMBIENT, 400.0, 20.0) >= 1e4  # it runs away


@pytest.mark.parametrize(("voltage", "current", "apart"), [(8.0, 9.0, 0.0), (8.0, 9.0, 30.0), (12.0, 12.0, 0.0)])
def test_a_protection_ends_the_current_before_any_actuator_passes_the_limit(actuators, voltage, current, apart):
    """The instrument trips as late as its accuracy lets it, and one of the two phases begins hotter than the other."""
    level = trip_level(BOX, LIMIT - MARGIN, apart, voltage, current, PROTECTION)
    trips_at = level * (1.0 + PROTECTION.share) + PROTECTION.beside
    actuators.begin([28.0 + apart, 28.0, 28.0], 28.0)
    hottest, tripped = actuators.leave_on(voltage, current, FOR_EVER_S, trips_at)
    assert tripped.any()
    assert LIMIT - 20.0 < hottest.max() < LIMIT
    actuators.begin([28.0 + apart, 28.0, 28.0], 28.0)
    assert actuators.leave_on(voltage, current, FOR_EVER_S)[0].max() > LIMIT + 10.0


def test_a_protection_trips_before_a_supply_that_is_low_takes_the_current_back(actuators):
    level = trip_level(BOX, LIMIT - MARGIN, 0.0, 6.0, 9.0, PROTECTION)
    trips_at = level * (1.0 + PROTECTION.share) + PROTECTION.beside
    actuators.begin([28.0] * 3, 28.0)
    low = 6.0 * (1.0 - VOLTAGE_ERROR_SHARE) - VOLTAGE_ERROR_V
    assert trips_at <= low
    hottest, tripped = actuators.leave_on(low, 9.0, FOR_EVER_S, trips_at * (1.0 - 1e-9))
    assert tripped.any()
    assert hottest.max() < LIMIT
    assert level < trip_level(BOX, LIMIT - MARGIN, 0.0, 8.0, 9.0, PROTECTION)


def test_of_two_phases_that_differ_the_hotter_one_counts():
    """The instrument sees the mean of both."""
    apart = trip_level(BOX, LIMIT - MARGIN, 30.0, 8.0, 9.0, PROTECTION)
    assert apart == pytest.approx(trip_level(BOX, LIMIT - MARGIN - 15.0, 0.0, 8.0, 9.0, PROTECTION), abs=1e-9)


def test_a_protection_that_would_end_the_current_at_once_is_none():
    assert trip_level(BOX, LIMIT - MARGIN, 0.0, 5.0, 9.0, PROTECTION) is None
    assert trip_level(BOX, LIMIT - MARGIN, 0.0, 8.0, 2.0, PROTECTION) is None
