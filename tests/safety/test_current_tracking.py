"""A drive's current against its demand: what contradicts it trips in time, what delay or voltage explain does not."""

import math
import types

import pytest

from leactl.driver.contract import Mode
from leactl.errors import SafetyTrip
from leactl.safety.current_tracking import FLOOR_SHARE, OFF_FLOORS, CurrentTracking, VoltageNeed
from leactl.safety.interlocks import CurrentDisagreement
from tests.safety.rig import LIMITS, Rig


@pytest.fixture
def make():
    rigs = []

    def build(*args, **kwargs):
        rigs.append(Rig(*args, **kwargs))
        return rigs[-1]

    yield build
    for rig in rigs:
        rig.drive.close()


def reads(rig, current):
    """The drive's current sensor says what it likes: a number, or a function of the true current."""
    true = rig.shaft.read

    def read():
        flowing, velocity, angle = true()
        return (current(flowing) if callable(current) else current), velocity, angle

    rig.shaft.read = read


def seconds_to_trip(rig, most):
    began = rig.clock.now()
    with pytest.raises(SafetyTrip, match=r"test q_axis_current of .* contradicts its demand of"):
        rig.run(most)
    return rig.clock.now() - began


@pytest.mark.parametrize("sensor", [0.0, lambda flowing: -flowing, lambda flowing: flowing / 1000.0])
def test_a_current_that_is_not_its_demand_trips_after_its_time(make, sensor):
    rig = make()
    rig.engage()
    rig.supervisor.command("test", 0.7)
    rig.run(0.3)
    reads(rig, sensor)
    assert seconds_to_trip(rig, 0.5) == pytest.approx(0.25, abs=0.005)


def test_a_current_that_nobody_asked_for_trips_engaged_and_off(make):
    rig = make("current_disagreement: {for_s: 0.05}")
    reads(rig, 1.5)
    assert seconds_to_trip(rig, 0.2) == pytest.approx(0.05, abs=0.005)
    rig = make("current_disagreement: {for_s: 0.05}")
    rig.engage()
    reads(rig, 0.2)
    assert seconds_to_trip(rig, 0.2) == pytest.approx(0.05, abs=0.005)


def test_the_zero_of_a_drive_that_is_off_is_no_current(make):
    rig = make()
    reads(rig, 0.99 * OFF_FLOORS * FLOOR_SHARE * LIMITS.current_A)
    rig.run(0.6)


@pytest.mark.parametrize("agreeing", [0.0, 0.5 * OFF_FLOORS * FLOOR_SHARE * LIMITS.current_A])
def test_a_disagreement_that_ends_in_time_is_forgotten(make, agreeing):
    rig = make("current_disagreement: {for_s: 0.05}")
    for _ in range(3):
        reads(rig, 1.5)
        rig.run(0.04)
        reads(rig, agreeing)
        rig.run(0.005)


def test_a_drive_that_chooses_its_current_is_not_judged(make):
    rig = make()
    rig.engage(Mode.VELOCITY)
    reads(rig, 3.0)
    rig.run(0.6)


def test_a_demand_that_alternates_faster_than_readings_come_is_no_disagreement(make):
    rig = make()
    rig.engage()
    signs = [1.0]

    def alternate():
        signs[0] = -signs[0]
        rig.supervisor.command("test", 8.0 * signs[0])

    rig.run(0.6, alternate)


def tracking(need=VoltageNeed(), **settings):  # noqa: B008 (it is frozen)
    trips = []
    motion = types.SimpleNamespace(engaged=True)
    result = CurrentTracking("test", motion, CurrentDisagreement(**settings), LIMITS, need, trips.append)
    result.turn_to(judges=True)
    return result, trips


def exchange(tracking, reading, demand, velocity, now):
    """Ask for a current and judge the reading, as the supervisor does in a cycle."""
    tracking.ask(demand)
    if not tracking.low <= reading <= tracking.high:
        tracking.look(reading, velocity, now)
    else:
        tracking.since = math.nan


@pytest.mark.parametrize("root", [1.0, math.sqrt(3.0)], ids=["wye", "delta"])
def test_a_demand_that_the_voltage_cannot_drive_is_judged_again_where_the_shaft_slows_down(root):
    """The delta has the leads of the wye: the same speeds excuse the same currents through them."""
    winding = "delta" if root > 1.0 else "wye"
    need = VoltageNeed(0.49 * root, 0.4 * root**2, winding)  # 14.1 V at the least: 20 A of the wye up to 12 rad/s
    found, trips = tracking(need)
    for cycle in range(500):
        exchange(found, 2.0 / root, 20.0 / root, 13.0, 0.001 * cycle)
    assert not trips
    for cycle in range(500, 745):
        exchange(found, 2.0 / root, 20.0 / root, 12.0, 0.001 * cycle)
    assert not trips
    for cycle in range(745, 752):
        exchange(found, 2.0 / root, 20.0 / root, 12.0, 0.001 * cycle)
    assert trips


def test_a_speed_that_is_not_known_excuses_nothing_and_a_missed_reading_ends_nothing():
    found, trips = tracking(VoltageNeed(0.49, 0.4))
    for cycle in range(256):
        exchange(found, math.nan if cycle % 2 else 0.0, 5.0, math.nan, 0.001 * cycle)
    assert trips


def test_slow_loops_wait_for_readings_that_are_of_the_demand():
    """At 10 Hz a quarter of a second is over before the readings of a step are there."""
    found, trips = tracking()
    for cycle, (reading, demand) in enumerate([(0.0, 0.0), (0.0, 9.0), (0.0, 9.0), (0.0, 9.0), (9.0, 9.0), (9.0, 9.0)]):
        exchange(found, reading, demand, 0.0, 0.1 * cycle)
    assert not trips


@pytest.mark.parametrize("factor", [0.01, 100.0])
def test_a_machine_of_another_size_is_judged_alike(factor):
    """Amperes of the limit and of the demand alike: the same reading over demand trips at the same time."""
    limits = LIMITS.model_copy(update={"current_A": factor * LIMITS.current_A})
    trips = []
    motion = types.SimpleNamespace(engaged=True)
    result = CurrentTracking("test", motion, CurrentDisagreement(), limits, VoltageNeed(), trips.append)
    result.turn_to(judges=True)
    for cycle in range(252):
        exchange(result, 0.6 * 0.7 * factor, 0.7 * factor, 0.0, 0.001 * cycle)
    assert not trips
    for cycle in range(252, 504):
        exchange(result, 0.2 * 0.7 * factor, 0.7 * factor, 0.0, 0.001 * cycle)
    assert trips
