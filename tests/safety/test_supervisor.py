"""The supervisor between a caller and real drivers on an emulated wire."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from leactl.driver.contract import Confirmation, Mode, Row
from leactl.errors import InputError, SafetyTrip
from leactl.safety.interlocks import CurrentDisagreement, Interlocks
from leactl.safety.limits import Limits
from leactl.safety.plan_checks import check_setpoints
from leactl.safety.supervisor import Axis, Supervisor
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.temperature_bound import ThermalBound
from tests.driver.elmo_bench import ElmoBench
from tests.safety.guards import LEA, guard_of

LIMITS = Limits(
    current_A=30,
    velocity_rad_s=40,
    torque_Nm=15,
    bus_voltage_low_V=20,
    bus_voltage_high_V=60,
    age_s=0.5,
    winding_temperature_degC=130,
)


class SupervisedBench(ElmoBench):
    def __init__(self, limits=LIMITS, start=28.0, **settings):
        super().__init__(**settings)
        self.drive.open()
        self.guard = guard_of(start=start)
        axes, patient = {"test": Axis(self.drive, self.drive)}, CurrentDisagreement(for_s=60.0)  # of drives that lie
        block = Interlocks(current_disagreement=patient)
        self.supervisor = Supervisor(limits, axes, [], self.clock, self.guard, block)

    def supervised_cycle(self, period=0.001):
        self.cycle(period)
        for row in self.drive.take():
            self.supervisor.receive(row)
        self.supervisor.check(self.clock.now())

    def engage(self, mode=Mode.CURRENT):
        self.supervisor.engage("test", mode)
        while not self.drive.engaged:
            self.supervised_cycle()


@pytest.fixture
def bench():
    bench = SupervisedBench()
    yield bench
    bench.drive.close()


def test_a_setpoint_inside_the_limits_reaches_the_drive(bench):
    bench.engage()
    bench.supervisor.command("test", 10.0)
    bench.supervised_cycle()
    bench.supervised_cycle()
    assert bench.shaft.following[1] == pytest.approx(10.0, abs=0.01)


@pytest.mark.parametrize("value", [30.001, -31.0, math.nan, math.inf])
def test_a_setpoint_outside_never_reaches_the_drive_and_latches(bench, value):
    bench.engage()
    with pytest.raises(SafetyTrip):
        bench.supervisor.command("test", value)
    with pytest.raises(SafetyTrip):
        bench.supervisor.command("test", 1.0)
    assert bench.shaft.following == ("current", 0.0)
    with pytest.raises(SafetyTrip):
        bench.supervisor.engage("test", Mode.CURRENT)


def test_a_measured_velocity_past_its_limit_trips_in_the_same_cycle(bench):
    bench.engage()
    bench.shaft.velocity = -40.5
    with pytest.raises(SafetyTrip, match=r"test velocity of -40.5 rad/s fell below the limit of -40 rad/s"):
        bench.supervised_cycle()


@pytest.mark.parametrize("period", [0.001, 0.02])
def test_the_winding_is_heated_by_the_mean_square_of_the_current_at_any_rate(period):
    bench = SupervisedBench(bus_voltage_period_s=0.1)
    bench.supervisor.begin(period)
    bench.engage()
    began, before = bench.clock.now(), bench.guard.hottest["test"]
    for half in range(10):
        bench.supervisor.command("test", 0.0 if half % 2 else 20.0)
        for _ in range(round(0.22 / period)):  # 2.2 s in all: a cold bound is told of heat once a second
            bench.supervised_cycle(period)
    alone = ThermalBound([Box.of(LEA)], before)
    alone.step(bench.clock.now() - began, np.array([200.0]), np.ones(1), np.zeros(1), 25.0, delay=0.0)
    bench.drive.close()
    assert bench.guard.hottest["test"] - before == pytest.approx(alone.hottest()[0] - before, rel=0.25)  # which is even


@pytest.mark.parametrize(
    ("period", "own", "least", "most"),
    [(0.001, None, 0.05, 0.053), (0.02, None, 0.06, 0.085), (0.02, 0.2, 0.2, 0.225)],
)
def test_a_channel_of_the_exchange_is_too_old_within_cycles_not_seconds(period, own, least, most):
    limits = LIMITS.model_copy(update={"cyclic_age_s": own, "age_s": 2.5})
    bench = SupervisedBench(limits, consumer_heartbeat_ms=1000)  # the drive's silence itself is noticed later
    bench.supervisor.begin(period)
    bench.engage()
    bench.supervised_cycle(period)
    bench.far.frozen, frozen = True, bench.clock.now()
    with pytest.raises(SafetyTrip, match=r"test q_axis_current: no reading for 0\."):
        for _ in range(600):
            bench.supervised_cycle(period)
    assert least <= bench.clock.now() - frozen + period <= most + period


def test_an_angle_alone_that_stays_away_is_too_old(bench):
    bench.engage()
    cycle = bench.drive.end_cycle

    def without_angle(deadline):
        cycle(deadline)
        bench.drive.values[5] = math.nan

    bench.drive.end_cycle = without_angle
    with pytest.raises(SafetyTrip, match=r"test angle: no reading for 0\.05"):
        for _ in range(100):
            bench.supervised_cycle()


def test_ages_count_from_where_the_loop_begins(bench):
    bench.clock.sleep_until(bench.clock.now() + 3.0)
    bench.drive._heard = bench.clock.now()
    bench.supervisor.begin(0.001)
    bench.supervised_cycle()


ANGLE_RAD = 7.0


@pytest.fixture
def turned(bench):
    """In angle mode at 50 Hz, engaged with the shaft well away from zero."""
    bench.shaft.angle = ANGLE_RAD
    bench.supervisor.begin(0.02)
    bench.supervisor.engage("test", Mode.ANGLE)
    while not bench.drive.engaged:
        bench.supervised_cycle(0.02)
    bench.supervised_cycle(0.02)
    return bench


@pytest.mark.parametrize("step", [0.7, -0.7])
def test_angles_follow_one_another_as_fast_as_the_shaft_may_turn(turned, step):
    for number in range(1, 20):
        turned.supervisor.command("test", ANGLE_RAD + step * number)
        turned.shaft.angle = ANGLE_RAD + step * number
        turned.supervised_cycle(0.02)
    assert turned.shaft.following == ("angle", pytest.approx(ANGLE_RAD + 19 * step, abs=1e-3))


@pytest.mark.parametrize("value", [20.0, -20.0, 0.0, 8.3, math.nan])
def test_a_leap_of_the_angle_never_reaches_the_drive(turned, value):
    for _ in range(15):  # a hold meanwhile does not make room for a leap
        turned.supervised_cycle(0.02)
    with pytest.raises(SafetyTrip, match="test angle_reference of"):
        turned.supervisor.command("test", value)
    assert turned.shaft.following == ("angle", pytest.approx(ANGLE_RAD, abs=1e-3))


@pytest.mark.parametrize(("leap", "passes"), [(1.9, True), (-1.9, True), (2.1, False), (-2.1, False)])
def test_a_bench_whose_drives_limit_their_speed_may_allow_a_leap(leap, passes):
    bench = SupervisedBench(LIMITS.model_copy(update={"angle_leap_rad": 2.0}))
    bench.supervisor.begin(0.02)
    bench.supervisor.engage("test", Mode.ANGLE)
    while not bench.drive.engaged:
        bench.supervised_cycle(0.02)
    bench.supervised_cycle(0.02)
    if passes:
        bench.supervisor.command("test", bench.shaft.angle + leap)
        bench.supervised_cycle(0.02)
        assert bench.shaft.following == ("angle", pytest.approx(bench.shaft.angle + leap, abs=1e-3))
    else:
        with pytest.raises(SafetyTrip, match="and angle_leap_rad is 2"):
            bench.supervisor.command("test", bench.shaft.angle + leap)


def test_many_setpoints_of_one_cycle_reach_no_further_than_one(turned):
    with pytest.raises(SafetyTrip, match="rad from 7 rad"):
        for number in range(1, 20):
            turned.supervisor.command("test", ANGLE_RAD + 0.5 * number)


def test_an_angle_is_refused_while_the_shaft_has_not_been_seen(bench):
    bench.supervisor.engage("test", Mode.ANGLE)
    with pytest.raises(SafetyTrip, match="while the shaft's angle is not known"):
        bench.supervisor.command("test", 0.0)


def test_a_bench_may_limit_the_angle_itself():
    bench = SupervisedBench(LIMITS.model_copy(update={"angle_rad": 1.0}))
    bench.supervisor.begin(0.02)
    bench.engage(Mode.ANGLE)
    with pytest.raises(SafetyTrip, match="outside the limits"):
        bench.supervisor.command("test", 1.01)
    with pytest.raises(InputError, match="load angle_reference: 3 rad is above the bench limit of 1 rad"):
        check_setpoints(bench.supervisor._limits, {("load", "angle_reference"): 3.0})
    bench = SupervisedBench(LIMITS.model_copy(update={"angle_rad": 1.0}))
    bench.shaft.angle = -1.1
    with pytest.raises(SafetyTrip, match=r"test angle of -1.1 rad fell below the limit of -1 rad"):
        bench.supervised_cycle()


def test_a_stream_that_never_spoke_is_too_old(bench):
    bench.drive.take = list
    with pytest.raises(SafetyTrip, match="bus_voltage: no reading"):
        for _ in range(600):
            bench.supervised_cycle()


def test_bus_voltage_outside_its_window_trips():
    bench = SupervisedBench(LIMITS.model_copy(update={"age_s": 2.0}))
    bench.shaft.bus_voltage = 61.0
    with pytest.raises(SafetyTrip, match=r"bus_voltage of 61 V passed the limit of 60 V"):
        for _ in range(1200):
            bench.supervised_cycle()


def test_a_fault_that_the_device_names_trips(bench):
    with pytest.raises(SafetyTrip, match="saturated"):
        bench.supervisor.receive(Row("drive_supply", 0.0, (math.nan,), "input torque is saturated at +4.096 V"))


def test_a_winding_is_heated_by_the_reference_where_the_measurement_lies():
    bench = SupervisedBench(bus_voltage_period_s=0.1)
    bench.supervisor.begin(0.001)
    bench.engage()
    bench.supervisor.command("test", 25.0)
    bench.shaft.read = lambda: (0.0, 0.0, 0.0)
    for _ in range(1100):  # a cold bound is told of heat once a second
        bench.supervised_cycle()
    assert 28.0 + 18.0 < bench.guard.hottest["test"] < 28.0 + 35.0
    bench.drive.close()


def test_a_winding_is_heated_by_the_measurement_where_a_drive_does_not_obey():
    bench = SupervisedBench(start=100.0, bus_voltage_period_s=0.1)
    bench.supervisor.begin(0.001)
    bench.engage()
    bench.shaft.read = lambda: (25.0, 0.0, 0.0)
    with pytest.raises(SafetyTrip, match=r"test winding: its hottest phase may be at 1\d\d\.\d degC"):
        for _ in range(3000):
            bench.supervised_cycle()
    assert 120.0 < bench.guard.hottest["test"] < 130.0
    bench.drive.close()


def test_a_current_is_scaled_down_as_a_winding_comes_near_its_limit_and_that_is_said_once():
    bench = SupervisedBench(start=110.0, bus_voltage_period_s=0.1)
    bench.supervisor.begin(0.001)
    bench.engage()
    for _ in range(20_000):
        bench.supervisor.command("test", 25.0)
        bench.supervised_cycle()
    assert 3.0 < bench.shaft.following[1] < 15.0
    assert 127.0 < bench.guard.hottest["test"] < 129.5
    [told] = bench.supervisor.take_warnings()
    assert told.startswith("test current of 25 A is scaled down, to ")
    bench.drive.close()


def test_every_end_is_safe_even_with_a_broken_driver(bench):
    class Broken:
        name = "broken"
        streams = ()

        def safe_state(self, deadline_s):
            raise RuntimeError("wires burnt")

    bench.engage()
    bench.supervisor._others = [Broken(), bench.drive]
    outcome = bench.supervisor.make_safe()
    assert outcome["broken"] == Confirmation(False, "RuntimeError: wires burnt")
    assert outcome["drive"].safe
    assert bench.shaft.following == ("off", 0.0)


def test_limits_are_required_and_finite():
    with pytest.raises(ValidationError):
        Limits(current_A=30)
    with pytest.raises(ValidationError):
        Limits(**{**LIMITS.model_dump(), "current_A": math.inf})
    with pytest.raises(ValidationError, match="is not below"):
        Limits(**{**LIMITS.model_dump(), "bus_voltage_low_V": 70})


def test_a_plan_beyond_the_limits_is_refused_before_anything_moves():
    with pytest.raises(InputError, match="test q_axis_current_reference: 45 A is above the bench limit of 30 A"):
        check_setpoints(LIMITS, {("test", "q_axis_current_reference"): 45.0, ("load", "angle_reference"): 3.0})
