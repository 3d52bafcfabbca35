"""Each interlock by what a drive or a sensor says on its wire: it trips, as late as it may, and not on less."""

import itertools
import math
import random

import pytest

from leactl import yamlfile
from leactl.driver.contract import Row
from leactl.errors import DeviceFault, NoAnswer, SafetyTrip
from leactl.quantities import ChannelSpec
from leactl.safety.cross_checks import Stuck
from leactl.safety.interlocks import Interlocks
from leactl.safety.watching import Panel
from tests.driver.elmo_bench import q_axis
from tests.safety.rig import HOUSING, LIMITS, Rig


@pytest.fixture
def make():
    rigs = []

    def build(*args, **kwargs):
        rigs.append(Rig(*args, **kwargs))
        return rigs[-1]

    yield build
    for rig in rigs:
        rig.drive.close()


def trips_after(rig, match, most, each=lambda: None):
    """Seconds until the trip, counted from now."""
    began = rig.clock.now()
    with pytest.raises(SafetyTrip, match=match):
        rig.run(most, each)
    return rig.clock.now() - began


def waving(rig):
    """The shaft's speed changes from cycle to cycle, as any that is measured does."""
    speeds = itertools.cycle((0.01, -0.01, 0.02))
    return lambda: setattr(rig.shaft, "velocity", next(speeds))


# -- a quantity: warn, trip, for how long ------------------------------------------------------------------------------


def test_a_value_beyond_its_trip_at_once_where_no_time_is_given(make):
    rig = make("velocity: {trip_rad_s: 10}")
    rig.run(0.01)
    rig.shaft.velocity = -10.5
    words = "test velocity of -10.5 rad/s fell below the interlock of -10 rad/s"
    assert trips_after(rig, words, 0.1) < rig.period


def test_a_value_beyond_its_trip_for_a_time_trips_after_it_and_not_before(make):
    rig = make("velocity: {role: test, trip_rad_s: 10, for_s: 0.05}")
    rig.shaft.velocity = 11.0
    rig.run(0.049)
    rig.shaft.velocity = 9.0
    rig.run(0.002)
    rig.shaft.velocity = 11.0
    assert trips_after(rig, r"passed the interlock of 10 rad/s for 0.05 s", 0.1) == pytest.approx(0.05, abs=2e-3)


def test_a_value_beyond_its_limit_trips_at_once_whatever_the_interlock_allows(make):
    rig = make("velocity: {trip_rad_s: 10, for_s: 5}")
    rig.run(0.01)
    rig.shaft.velocity = 41.0
    assert trips_after(rig, "passed the limit of 40 rad/s", 0.1) < rig.period


def test_current_angle_and_torque_have_interlocks_of_their_own(make):
    rig = make("{q_axis_current: {trip_A: 5}, angle: {trip_low_rad: -2, trip_high_rad: 3}, torque: {trip_Nm: 6}}")
    rig.engage()
    rig.supervisor.command("test", 5.2)
    assert trips_after(rig, "test q_axis_current of 5.", 0.1) < 3 * rig.period
    rig = make("angle: {trip_low_rad: -2, trip_high_rad: 3}")
    rig.shaft.angle = -2.5
    assert trips_after(rig, "test angle of -2.5 rad fell below the interlock of -2 rad", 0.1) < rig.period
    rig = make("torque: {trip_Nm: 6}")
    rig.converter.apply(1.3)
    assert trips_after(rig, "test torque of 6.5 N.m passed the interlock of 6 N.m", 0.1) < 5 * rig.period


def test_another_role_s_entry_is_not_this_one_s(make):
    rig = make("velocity: [{role: load, trip_rad_s: 1}, {role: test, trip_rad_s: 20}]")
    rig.shaft.velocity = 15.0
    rig.run(0.01)
    rig.shaft.velocity = 21.0
    assert trips_after(rig, "interlock of 20 rad/s", 0.1) < rig.period


def test_a_supply_out_of_its_band_trips(make):
    rig = make("supply: {expected_V: 29.6, band_V: 3}", bus_voltage_period_s=0.05)
    rig.run(0.2)
    rig.shaft.bus_voltage = 26.0  # well inside the limits of 20 to 60 V
    assert trips_after(rig, "test bus_voltage of 26 V fell below the interlock of 26.6 V", 1) < 0.06


def test_a_warning_is_told_once_a_crossing(make):
    rig = make("velocity: {warn_rad_s: 5}")
    rig.run(0.01)
    assert rig.supervisor.take_warnings() == []
    speeds = itertools.cycle((5.5, 4.99, 5.2))  # noise at the threshold is one crossing
    rig.run(0.5, lambda: setattr(rig.shaft, "velocity", next(speeds)))
    assert rig.supervisor.take_warnings() == ["test velocity of 5.5 rad/s passed 5 rad/s, where it warns"]
    rig.shaft.velocity = 1.0
    rig.run(1.2)
    rig.shaft.velocity = -6.0
    rig.run(0.1)
    assert rig.supervisor.take_warnings() == ["test velocity of -6 rad/s fell below -5 rad/s, where it warns"]


# -- rate of change ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("leap", [1.1, -1.1])
@pytest.mark.parametrize("quiet", [True, False])
def test_a_leap_from_one_reading_to_the_next_trips(make, quiet, leap):
    rig = make(f"velocity: {{rate_rad_s_per_s: 1000{'' if quiet else ', warn_rad_s: 0.1'}}}")
    for number in range(20):
        rig.shaft.velocity = 0.9 * number  # 900 rad/s^2
        rig.supervised_cycle()
    rig.shaft.velocity += leap
    words = rf"test velocity changed by {leap} rad/s in 0.001 s; the interlock's rate is 1000 \(rad/s\)/s"
    assert trips_after(rig, words, 0.1) < rig.period


def test_a_channel_whose_rate_is_watched_keeps_its_limit(make):
    rig = make("velocity: {rate_rad_s_per_s: 1000}")
    for number in range(45):
        rig.shaft.velocity = 0.9 * number
        rig.supervised_cycle()
    rig.shaft.velocity = 40.5
    assert trips_after(rig, "test velocity of 40.5 rad/s passed the limit of 40 rad/s", 0.1) < rig.period


def test_readings_that_stayed_away_give_a_change_the_time_it_had(make):
    rig = make("velocity: {rate_rad_s_per_s: 1000}", consumer_heartbeat_ms=1000)
    rig.run(0.01)
    rig.far.frozen = True
    rig.run(0.02)
    rig.far.frozen, rig.shaft.velocity = False, 5.0
    rig.supervised_cycle()


# -- temperatures ------------------------------------------------------------------------------------------------------


def test_a_temperature_warns_and_trips_after_its_time(make):
    rig = make("housing_temperature: {warn_degC: 70, trip_degC: 85, for_s: 0.5}", HOUSING, start=90.0)
    rig.converter.apply(0.72)
    rig.run(0.2)
    (told,) = rig.supervisor.take_warnings()
    assert told.startswith("test housing_temperature of 72 degC passed 70 degC")
    rig.converter.apply(0.86)
    assert trips_after(rig, "of 86 degC passed the interlock of 85 degC", 2) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    ("volts", "words"),
    [
        (2.98, r"of 298 degC passed the limit of 200 degC \(kelvin\? 24.9 degC would be\)"),
        (-0.45, "of -45 degC fell below the limit of -40 degC"),
    ],
)
def test_a_temperature_in_kelvin_or_colder_than_any_bench_trips(make, volts, words):
    rig = make("housing_temperature: {warn_degC: 199}", HOUSING)
    rig.converter.apply(volts)
    assert trips_after(rig, words, 0.1) < 5 * rig.period


def test_a_temperature_that_is_no_number_is_never_read_as_cool(make):
    rig = make("housing_temperature: {trip_degC: 85, age_s: 0.1}", HOUSING)
    rig.sensor.take = lambda: [Row("sensor", rig.clock.now(), (math.nan,))]
    assert trips_after(rig, "housing_temperature: no reading for 0.1", 1) == pytest.approx(0.1, abs=0.01)


def test_a_temperature_that_stands_still_to_the_last_digit_trips(make):
    rig = make("housing_temperature: {trip_degC: 85, stuck_s: 1}", HOUSING, period=0.01)
    rig.converter.apply(0.25)
    words = "test housing_temperature has been exactly 25 degC for 1 s while others moved: stuck"
    assert 1.0 <= trips_after(rig, words, 3, waving(rig)) <= 2.1
    ordinary = make("housing_temperature: {trip_degC: 85}", HOUSING, period=0.04)
    ordinary.converter.apply(0.25)
    assert 600 <= trips_after(ordinary, "for 600 s while others moved", 1300, waving(ordinary)) <= 1201


# -- what no value shows -----------------------------------------------------------------------------------------------


def test_a_sensor_that_is_stuck_trips_and_one_that_moves_does_not(make):
    rig = make("torque: {stuck_s: 0.2}")
    rig.converter.climb(1e-4)
    rig.run(1.0, waving(rig))
    rig.converter.climb(0.0)
    assert 0.2 <= trips_after(rig, "test torque has been exactly .* for 0.2 s", 1, waving(rig)) <= 0.42


def test_a_sensor_that_is_stuck_trips_though_a_sample_is_lost_now_and_then(make):
    rig = make("torque: {stuck_s: 0.2, age_s: 1}")
    count = itertools.count()
    rig.sensor.take = lambda: [Row("sensor", rig.clock.now(), (math.nan if next(count) % 100 < 3 else 1.5,))]
    assert 0.2 <= trips_after(rig, "test torque has been exactly 1.5 N.m for 0.2 s", 1, waving(rig)) <= 0.42


def test_a_sensor_that_is_stuck_trips_though_the_only_other_channel_is_lost_where_its_stretch_begins():
    far = Panel([ChannelSpec("a", "torque", "test", "d")], LIMITS, Interlocks(), trip, lambda text: None)
    near = Panel([ChannelSpec("b", "line_current", "test", "d")], LIMITS, Interlocks(), trip, lambda text: None)
    stuck = Stuck([far, near], yamlfile.parse("torque: {stuck_s: 1}").validate(Interlocks))
    with pytest.raises(SafetyTrip, match=r"test torque has been exactly 2 N\*m for 1 s"):
        for cycle in range(300):
            far.values = (2.0,)
            near.values = (math.nan if cycle % 100 == 0 else math.sin(cycle),)
            stuck.look(0.01 * cycle)


def test_the_time_for_which_a_current_is_not_read_is_no_time_of_operation():
    specs = [ChannelSpec("i", "q_axis_current", "test", "d"), ChannelSpec("e", "drive_enabled", "test", "d")]
    drive = Panel(specs, LIMITS, Interlocks(), trip, lambda text: None)
    other = Panel([ChannelSpec("b", "line_current", "test", "d")], LIMITS, Interlocks(), trip, lambda text: None)
    stuck = Stuck([drive, other], yamlfile.parse("q_axis_current: {stuck_s: 5}").validate(Interlocks))
    for cycle in range(1200):
        now = 0.01 * cycle
        drive.values = (0.0, 0.0) if now < 0.05 else (math.nan, math.nan) if now < 10.0 else (0.0, 1.0)
        other.values = (math.sin(cycle),)
        stuck.look(now)


def trip(text):
    raise SafetyTrip(text)


def test_a_channel_without_a_number_is_not_stuck(make):
    rig = make("torque: {stuck_s: 0.2, age_s: 5}")
    rig.sensor.take = lambda: [Row("sensor", rig.clock.now(), (math.nan,))]
    rig.run(2.0, waving(rig))


def test_a_sensor_that_is_stuck_trips_within_two_stretches_of_a_few_cycles_each(make):
    rig = make("torque: {stuck_s: 0.3}", period=0.05)
    rig.converter.apply(0.25)
    assert 0.3 <= trips_after(rig, "test torque has been exactly .* for 0.3 s", 3, waving(rig)) <= 0.7


@pytest.mark.parametrize("quantity", ["angle", "velocity"])
def test_an_angle_and_a_velocity_are_stuck_only_where_the_other_tells_of_motion(make, quantity):
    rig = make(f"{quantity}: {{stuck_s: 0.2}}")
    rig.converter.climb(1e-4)  # the torque moves all the time
    rig.run(1.0)  # at rest
    rig.shaft.velocity = 0.5
    turned = itertools.count(1)
    rig.run(0.5, lambda: turning(rig, next(turned)))
    if quantity == "angle":
        assert 0.2 <= trips_after(rig, "test angle has been exactly .* for 0.2 s", 1) <= 0.42
    else:
        each = lambda: setattr(rig.shaft, "angle", 5e-4 * next(turned))  # noqa: E731
        assert 0.2 <= trips_after(rig, "test velocity has been exactly 0.50.* for 0.2 s", 1, each) <= 0.42


def swinging(rig, reach, broken):
    """The shaft swings by so many rad to either side at 5 Hz, of which one quantity is not reported."""
    began, still = rig.clock.now(), getattr(rig.shaft, broken)

    def each():
        phase = 2 * math.pi * 5 * (rig.clock.now() - began)
        rig.shaft.angle, rig.shaft.velocity = reach * math.sin(phase), 2 * math.pi * 5 * reach * math.cos(phase)
        setattr(rig.shaft, broken, still)

    return each


@pytest.mark.parametrize("quantity", ["angle", "velocity"])
def test_an_angle_or_a_velocity_that_stands_while_its_shaft_swings_is_stuck(make, quantity):
    rig = make(f"{quantity}: {{stuck_s: 0.5}}")
    words = f"test {quantity} has been exactly .* for 0.5 s"
    assert 0.5 <= trips_after(rig, words, 2, swinging(rig, 0.1, quantity)) <= 1.02
    small = make(f"{quantity}: {{stuck_s: 0.5}}")  # 0.1 rad/s of 0.5 s are twice 0.025 rad
    small.run(2.0, swinging(small, 0.02, quantity))


@pytest.mark.parametrize("quantity", ["angle", "velocity"])
def test_an_angle_or_a_velocity_that_stands_is_stuck_though_an_answer_is_lost_now_and_then(make, quantity):
    rig = make(f"{quantity}: {{stuck_s: 0.5}}")
    swing, cycles = swinging(rig, 0.1, quantity), itertools.count(1)

    def each():
        swing()
        rig.far.frozen = next(cycles) % 40 == 0  # at no end of the swing, whose reach counts

    assert 0.5 <= trips_after(rig, f"test {quantity} has been exactly .* for 0.5 s", 2, each) <= 1.02


def test_an_angle_at_rest_is_not_stuck_beside_a_noisy_velocity_and_a_velocity_not_beside_a_coarse_angle(make):
    rig = make("{angle: {stuck_s: 0.5}, torque: {stuck_s: 100}}")
    noise = random.Random(5)
    rig.run(10.0, lambda: setattr(rig.shaft, "velocity", noise.gauss(0.0, 0.3)))
    rig = make("velocity: {stuck_s: 0.5}")
    rig.run(2.0, lambda: setattr(rig.shaft, "angle", 0.01 * noise.randint(0, 1)))


def test_an_angle_that_stands_while_its_shaft_turns_evenly_is_stuck_though_nothing_else_moves(make):
    rig = make("angle: {stuck_s: 0.2}")
    rig.shaft.velocity = 0.5
    assert 0.2 <= trips_after(rig, "test angle has been exactly .* for 0.2 s", 1) <= 0.42


def test_a_current_of_none_is_stuck_only_in_operation(make):
    rig = make("q_axis_current: {stuck_s: 0.2}")
    rig.run(1.0, waving(rig))  # off
    rig.engage()
    assert trips_after(rig, "test q_axis_current has been exactly 0 A for 0.2 s of operation", 1, waving(rig)) <= 0.62


def test_a_current_other_than_none_is_stuck_although_its_drive_is_off():
    specs = [ChannelSpec("i", "q_axis_current", "test", "d"), ChannelSpec("e", "drive_enabled", "test", "d")]
    drive = Panel(specs, LIMITS, Interlocks(), trip, lambda text: None)
    other = Panel([ChannelSpec("b", "line_current", "test", "d")], LIMITS, Interlocks(), trip, lambda text: None)
    stuck = Stuck([drive, other], yamlfile.parse("q_axis_current: {stuck_s: 1}").validate(Interlocks))
    drive.values = (0.02, 0.0)
    with pytest.raises(SafetyTrip, match=r"test q_axis_current has been exactly 0\.02 A for 1 s while others moved"):
        for cycle in range(210):
            other.values = (math.sin(cycle),)
            stuck.look(0.01 * cycle)


def test_a_dead_current_is_stuck_although_its_drive_is_off_now_and_then(make):
    rig = make("q_axis_current: {stuck_s: 0.2}")
    with pytest.raises(SafetyTrip, match="test q_axis_current has been exactly 0 A"):
        for _ in range(8):
            rig.engage()
            rig.run(0.15, waving(rig))
            rig.supervisor.release("test")
            rig.run(0.02, waving(rig))


def turning(rig, cycle):
    """The shaft turns at about 0.5 rad/s."""
    rig.shaft.angle, rig.shaft.velocity = 5e-4 * cycle, 0.5 + 1e-3 * (cycle % 3)


def test_a_bench_on_which_nothing_moves_is_not_stuck(make):
    make("torque: {stuck_s: 0.1}").run(1.0)


def test_a_saturated_sensor_trips_by_its_driver_s_word(make):
    rig = make(sensor={**HOUSING, "quantity": "torque", "scale_per_V": 3.0})
    rig.converter.apply(4.2)
    assert trips_after(rig, r"input t is saturated at \+4.096 V", 0.1) < 5 * rig.period


# -- ages --------------------------------------------------------------------------------------------------------------


def test_every_channel_of_every_device_has_an_age(make):
    """Also those that nothing limits: here the shaft's torque may be anything, and the enabled flag is no quantity."""
    rig = make("torque: {age_s: 0.2}")
    rig.run(0.05)
    rig.sensor.take = list
    assert trips_after(rig, r"test torque: no reading for 0\.2", 1) == pytest.approx(0.2, abs=0.01)
    rig = make()
    rig.run(0.05)
    rig.port.listen(0x181, lambda _data, _time: None)  # its TPDO 1 comes no more
    assert trips_after(rig, "test q_axis_current: no reading", 1) < 0.09
    rig = make()
    rig.run(0.05)
    cycle = rig.drive.end_cycle

    def without_flag(deadline):
        cycle(deadline)
        rig.drive.values[6] = math.nan

    rig.drive.end_cycle = without_flag
    assert trips_after(rig, "test drive_enabled: no reading for 0.05", 1) < 0.06


def test_a_channel_that_never_arrived_trips(make):
    rig = make(limits=LIMITS.model_copy(update={"age_s": 0.3}), bus_voltage_period_s=60)
    rig.sensor.take = list
    assert trips_after(rig, "no reading for 0.3", 1) == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize(("ahead_s", "told"), [(100.0, "9"), (0.6, r"0\.[23]")])
def test_a_reading_stamped_ahead_of_the_clock_trips(make, ahead_s, told):
    rig = make(limits=LIMITS.model_copy(update={"age_s": 0.3}))
    rig.run(0.01)
    rig.sensor.take = lambda: [Row("sensor", rig.clock.now() + ahead_s, (0.0,))]
    rig.supervised_cycle()
    rig.sensor.take = list
    assert trips_after(rig, f"test torque: a reading is stamped {told}.* ahead of the bench's clock", 1) < 0.32


def test_a_value_may_change_by_its_rate_and_repeat_within_one_moment():
    panel = Panel(
        [ChannelSpec("a", "torque", "test", "d")],
        LIMITS,
        yamlfile.parse("torque: {rate_Nm_per_s: 4}").validate(Interlocks),
        trip,
        lambda text: None,
    )
    panel.begin(0.0, 1.0)
    for value, now in ((1.0, 0.25), (1.0, 0.25), (2.0, 0.5)):
        panel.look((value,), now)
    with pytest.raises(SafetyTrip, match=r"test torque changed by 1 N\*m in 0 s; the interlock's rate is 4"):
        panel.look((3.0,), 0.5)


# -- the loop and its clock --------------------------------------------------------------------------------------------


def test_overruns_in_a_row_trip(make):
    rig = make("loop_overruns: {in_a_row: 5}")
    rig.run(0.05)
    late = lambda: rig.clock.sleep_until(rig.clock.now() + 0.003)  # noqa: E731
    for _ in range(3):
        rig.run(0.004, late)
        rig.run(0.002)
    with pytest.raises(SafetyTrip, match="5 loop overruns in a row; fewer than 5 are allowed"):
        rig.run(0.006, late)


def test_a_share_of_overruns_trips_and_a_smaller_one_does_not(make):
    rig = make("loop_overruns: {share_percent: 10, window_s: 0.5}")  # 50 of 500 cycles

    def every(cycles):
        for _ in range(120):
            rig.run((cycles - 1) * 0.001)
            rig.clock.sleep_until(rig.clock.now() + 0.0025)
            rig.supervised_cycle()

    every(14)
    with pytest.raises(SafetyTrip, match=r"51 loop overruns in 0.5 s; 10 % of the cycles are allowed"):
        every(4)


def test_a_clock_that_goes_back_or_leaps_trips(make):
    rig = make("clock: {jump_s: 0.25}", consumer_heartbeat_ms=1000)
    rig.run(0.05)
    rig.clock.sleep_until(rig.clock.now() + 0.2)
    rig.drive._heard = rig.clock.now()
    rig.supervised_cycle()
    rig.clock.sleep_until(rig.clock.now() + 0.3)
    rig.drive._heard = rig.clock.now()
    with pytest.raises(SafetyTrip, match=r"the bench's clock went on by 0.301 s in one cycle; 0.25 s are allowed"):
        rig.supervised_cycle()
    rig = make()
    rig.run(0.05)
    rig.clock._time -= 0.002
    with pytest.raises(SafetyTrip, match=r"the bench's clock went back by 0.001 s"):
        rig.supervised_cycle()


def test_a_slow_loop_is_allowed_cycles_rather_than_the_jump(make):
    rig = make("clock: {jump_s: 0.01}", period=0.02, consumer_heartbeat_ms=1000)
    rig.run(0.2)
    rig.clock.sleep_until(rig.clock.now() + 0.07)
    rig.supervised_cycle()
    rig.clock.sleep_until(rig.clock.now() + 0.09)
    with pytest.raises(SafetyTrip, match=r"went on by 0\.11 s in one cycle; 0\.1 s are allowed"):
        rig.supervised_cycle()


# -- the drive itself --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engaged", [False, True])
def test_a_drive_s_fault_ends_the_cycle_that_hears_of_it(make, engaged):
    rig = make()
    if engaged:
        rig.engage()
    rig.run(0.01)
    rig.far.fault(0x4310)
    with pytest.raises(DeviceFault, match=r"emergency 0x4310 \(drive over-temperature\)"):
        rig.supervised_cycle()


def test_a_drive_whose_heartbeat_stays_away_ends_the_run(make):
    rig = make()
    rig.run(0.1)
    rig.far._next_heartbeat = math.inf
    began = rig.clock.now()
    with pytest.raises(NoAnswer, match="no heartbeat of node 1"):
        rig.run(1)
    assert rig.clock.now() - began <= 3 * 0.05 + 0.1 + 2 * rig.period  # three of the drive's, one of the host's


# -- the disk ----------------------------------------------------------------------------------------------------------


def test_a_disk_that_fills_up_warns_once_and_trips(make):
    rig = make("disk_space: {warn_MB: 500, trip_MB: 100}")
    for megabytes in (900, 499, 300, 101):
        rig.supervisor.free_space(megabytes * 1e6)
    assert rig.supervisor.take_warnings() == ["disk: 499 MB are free; below 100 MB the run trips"]
    with pytest.raises(SafetyTrip, match="disk: 99 MB are free; 100 MB at least are required"):
        rig.supervisor.free_space(99e6)


# -- a trip ------------------------------------------------------------------------------------------------------------


def test_whoever_cycles_on_after_a_trip_switches_the_drive_off(make):
    rig = make("velocity: {trip_rad_s: 10}")
    rig.engage()
    rig.supervisor.command("test", 8.0)
    rig.run(0.01)
    assert rig.shaft.following[1] == pytest.approx(8.0, abs=q_axis(1))
    rig.shaft.velocity = 11.0
    with pytest.raises(SafetyTrip):
        rig.supervised_cycle()
    with pytest.raises(SafetyTrip):
        rig.supervised_cycle()
    assert rig.sent(0x201)[-1] == bytes.fromhex("0000000000")
    assert rig.shaft.following == ("off", 0.0)
