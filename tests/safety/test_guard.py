"""The thermal guard: what it counts as heat, when it trips, what it lets through, and plants that it keeps whole."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl import yamlfile
from leactl.driver.contract import Mode
from leactl.errors import SafetyTrip
from leactl.safety.interlocks import Interlocks
from leactl.safety.supervisor import Axis, Supervisor
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.temperature_bound import HOTTEST, ThermalBound
from leactl.safety.thermal.turning import Rotor, detour, largest_acceleration
from tests.driver.elmo_bench import ElmoBench
from tests.safety.guards import LEA, SETTINGS, guard_of, passed
from tests.safety.phases import STEP_S, Plant, advance
from tests.safety.rig import LIMITS

PATIENT = """
clock: {jump_s: 10}
loop_overruns: {in_a_row: 10000, share_percent: 99, window_s: 600}
current_disagreement: {for_s: 60}  # of shafts that say what they like
"""
WORST = (1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0)  # resistances high, capacitances low


def fed(guard, seconds, current=0.0, role=0, period=0.01, began=0.0, scaled=False, moves=lambda now: (0.0, 0.0)):
    """Cycles with this current in one role, until the guard has a word to say; gives it, and when.

    `moves` says angle and velocity of every rotor at a time.
    """
    now = began
    while now < began + seconds - 1e-9:
        now += period
        flows = min(current, guard.allowed[guard.roles[role]]) if scaled else current
        passed(guard, period, {role: flows}, moves(now))
        cause = guard.check(now) if now >= guard.due else ""
        if cause:
            return cause, now
    return "", now


def ready(start=28.0, roles=("test",), **changes):
    guard = guard_of(roles, start, replace(SETTINGS, **changes))
    guard.begin(0.0)
    return guard


@pytest.mark.parametrize("reserve", [0.05, 0.22, 1.0])
def test_a_trip_comes_early_enough_for_a_drive_that_goes_on(reserve):
    guard = ready(start=60.0, reserve_s=reserve, limit=120.0)
    cause, _when = fed(guard, 60.0, current=20.0)
    assert cause.startswith("test winding: its hottest phase may be at ")
    assert f"{reserve:g} s on; the limit is 120 degC" in cause
    bound = ThermalBound([Box.of(LEA)], 25.0)
    bound.set(guard.node_bounds["test"][:, None])
    bound.step(reserve, np.array([400.0]), np.ones(1), np.zeros(1), 25.0, delay=0.0)
    assert 116.0 < bound.hottest()[0] <= 120.0


def test_a_longer_reserve_trips_earlier():
    times = [fed(ready(start=60.0, reserve_s=reserve), 60.0, current=20.0)[1] for reserve in (0.02, 0.5, 1.0)]
    assert times[0] > times[1] + 0.3 > times[2] + 0.6


def turning_at(speed):
    return lambda now: (speed * now, speed)


def hottest_after(moves, seconds=5.0, current=14.0):
    guard = ready()
    assert fed(guard, seconds, current=current, period=0.001, moves=moves)[0] == ""
    return guard.hottest["test"]


def test_turning_spreads_the_heat_over_the_phases():
    assert hottest_after(turning_at(8.0)) < hottest_after(turning_at(0.0)) - 8.0


@pytest.mark.parametrize(
    "moves",
    [
        lambda now: (math.nan, 8.0),
        lambda now: (8.0 * now, math.nan),
        lambda now: (math.nan, math.nan),
        lambda now: (0.3, 8.0),  # an angle that is stuck
        lambda now: (8.0 * now, 0.0),  # a velocity that is
        lambda now: (0.04 * math.sin(1e6 * now), 0.0),  # noise, which goes forth and back
        lambda now: (0.04 * math.sin(1e6 * now), 40.0 * math.sin(1e6 * now)),
        lambda now: (0.04 * math.sin(300.0 * now), 12.0 * math.cos(300.0 * now)),  # forth and back within 21 cycles
    ],
)
def test_a_rotor_of_which_angle_and_velocity_do_not_both_say_that_it_turns_stands(moves):
    assert hottest_after(moves) >= hottest_after(turning_at(0.0)) - 0.3


def test_a_velocity_that_is_not_known_heats_the_housing_by_the_fastest():
    known, unknown = ready(), ready()
    fed(known, 60.0)
    fed(unknown, 60.0, moves=lambda now: (math.nan, math.nan))
    friction = 0.9 * (0.208 + 0.0238 * SETTINGS.most_speed) * SETTINGS.most_speed  # W
    assert unknown.node_bounds["test"][2] - known.node_bounds["test"][2] > 0.5 * friction * 60.0 / 469.1


def test_a_clock_that_goes_back_ends_the_run():
    guard = ready()
    assert guard.check(1.0) == ""
    assert "gone backwards" in guard.check(0.99)


@pytest.mark.parametrize("start", [60.0, 120.0, 129.4, 130.0, pytest.param(150.0, marks=pytest.mark.long)])
def test_a_hot_start_without_current_cools_and_never_trips(start):
    guard = ready(start=start)
    cause, _when = fed(guard, 120.0)
    assert cause == ""
    assert guard.hottest["test"] < start - 3.0


@pytest.mark.parametrize("start", [math.nan, math.inf])
def test_a_start_that_is_no_number_trips_without_current(start):
    assert "winding" in fed(ready(start=start), 1.0)[0]


@pytest.mark.parametrize("start", [129.6, 130.0, 150.0])
@pytest.mark.parametrize("pattern", [[6.0], [0.0, 20.0], [20.0, 0.0], [0.0] * 9 + [30.0]])
def test_a_start_above_the_limit_carries_nothing(start, pattern):
    """Current that comes and goes from cycle to cycle stops the bench as well."""
    guard, now, cause = ready(start=start), 0.0, ""
    while now < 1.0 and not cause:
        for current in pattern:
            cause = cause or fed(guard, 0.001, current, period=0.001, began=now)[0]
            now += 0.001
    assert cause.startswith("test winding")
    assert guard.hottest["test"] < start + 0.4


@pytest.mark.parametrize("period", [0.001, 0.01, 0.05])
@pytest.mark.parametrize("speed", [0.0, 20.0])
def test_the_current_that_is_allowed_keeps_the_bound_below_the_limit(period, speed):
    guard = ready(start=100.0)
    cause, _when = fed(guard, 40.0, current=30.0, period=period, scaled=True, moves=turning_at(speed))
    assert cause == ""
    assert 122.0 < guard.hottest["test"] < SETTINGS.limit - 0.5
    assert 0.0 < guard.allowed["test"] < 15.0


def test_bounds_that_cannot_be_kept_stop_the_bench():
    guard = ready()
    faults = [""]
    guard.remember(lambda: faults[-1])
    assert fed(guard, 2.0)[0] == ""
    faults.append("the windings' state was not written for 11 s: full")
    assert fed(guard, 2.0, began=2.0) == (
        "the windings' state was not written for 11 s: full",
        pytest.approx(2.5, abs=0.5),
    )


def test_each_role_is_told_by_itself():
    guard = ready(roles=("test", "load"))
    fed(guard, 4.0, current=12.0, role=1)
    assert guard.hottest["test"] == pytest.approx(28.0, abs=0.1)
    assert guard.estimate["test"] < 28.0
    assert guard.hottest["load"] > 37.0
    assert 29.0 < guard.estimate["load"] < guard.node_bounds["load"][1] < guard.hottest["load"]


def test_a_trip_names_the_role_that_is_hot():
    guard = ready(roles=("test", "load"), start=100.0)
    assert fed(guard, 30.0, current=25.0, role=1)[0].startswith("load winding: ")


# -- through a supervisor, over the emulated wire ---------------------------------------------------------------------


class HeatedRig(ElmoBench):
    """A supervised drive whose current heats a plant of three phases, stepped finely beside it."""

    def __init__(self, plant, start, period):
        super().__init__(consumer_heartbeat_ms=1000)
        self.drive.open()
        limits = LIMITS.model_copy(update={"cyclic_age_s": 5.0, "age_s": 600.0})
        self.guard = guard_of(start=start)
        interlocks = yamlfile.parse(PATIENT).validate(Interlocks)
        axes = {"test": Axis(self.drive, self.drive)}
        self.supervisor = Supervisor(limits, axes, [], self.clock, self.guard, interlocks)
        self.supervisor.begin(period)
        self.period, self.plant = period, plant
        self.state = np.full(4, start if start > 28.0 else plant.ambient)
        self.peak, self._heat, self._since = self.state[:3].max(), 0.0, 0.0
        self.supervisor.engage("test", Mode.CURRENT)
        while not self.drive.engaged:
            self.cycle()

    def cycle(self):
        self.drive.begin_cycle()
        self.port.sync()
        self.drive.end_cycle(self.clock.now() + 0.5 * self.period)
        for row in self.drive.take():
            self.supervisor.receive(row)
        self.supervisor.check(self.clock.now())
        self.drive.feed()
        self.pass_time(self.period)

    def pass_time(self, seconds):
        """What flows goes on; the plant in fine steps, the rotor with it."""
        self.clock.sleep_until(self.clock.now() + seconds)
        parts = math.ceil(seconds / (0.25 * STEP_S))
        for _ in range(parts):  # a rotor passes every angle on its way
            self._go_on(seconds / parts)

    def _go_on(self, seconds):
        self._heat += self.shaft.read()[0] ** 2 * seconds
        self._since += seconds
        self.shaft.angle += self.shaft.velocity * seconds
        while self._since > STEP_S - 1e-9:
            part = min(1.0, STEP_S / self._since)
            current = math.sqrt(self._heat / self._since)
            self.state = advance(self.plant, self.state, current, self.shaft.angle, self.shaft.velocity)
            self._heat, self._since = self._heat * (1.0 - part), max(self._since - STEP_S, 0.0)
            self.peak = max(self.peak, self.state[:3].max())

    def follow(self, course):
        """(seconds, current asked for, speed, current that flows whatever is asked for or None); whether it tripped."""
        try:
            for seconds, asked, speed, own in course:
                self.shaft.velocity = speed
                if own is not None:
                    self.shaft.read = lambda own=own: (own, self.shaft.velocity, self.shaft.angle)
                for _ in range(round(seconds / self.period)):
                    self.supervisor.command("test", asked)
                    self.cycle()
        except SafetyTrip:
            return True
        return False


corner = st.sampled_from([-1.0, 1.0]) | st.floats(-1.0, 1.0)
pieces = st.tuples(
    st.sampled_from([0.05, 0.3, 1.0, 2.5]),
    st.sampled_from([0.0, 9.0, -14.0, 22.0, 30.0]),
    st.sampled_from([0.0, 0.02, 0.4, -7.66, 12.0, 38.0]),  # at 7.66 rad/s and 100 Hz an electrical half turn a cycle
    st.sampled_from([None, None, None, 29.9]),
)


@pytest.mark.parametrize(("period", "share"), [(0.01, 1.0), (0.001, 0.4)])
@settings(max_examples=15)
@given(
    places=st.tuples(*[corner] * 11) | st.just(WORST),
    offset=st.floats(0.0, math.pi),
    start=st.sampled_from([28.0, 100.0, 122.0, 128.5, 129.3]),
    course=st.lists(pieces, min_size=1, max_size=6),
)
def test_no_plant_of_the_box_passes_its_limit_whatever_is_asked_or_done(period, share, places, offset, start, course):
    rig = HeatedRig(Plant.inside(places, offset), start, period)
    for _ in range(3):
        if rig.follow([(seconds * share, *rest) for seconds, *rest in course]):
            break
    assert rig.peak <= 130.0
    rig.supervisor.make_safe()
    rig.pass_time(STEP_S)  # the plant is up to a step behind
    assert rig.guard.node_bounds["test"][HOTTEST] >= rig.state[:3].max()
    rig.drive.close()


@pytest.mark.parametrize("period", [0.001, 0.01])
@pytest.mark.parametrize("start", [100.0, 122.0, 128.0, 129.4])
def test_a_jump_to_the_bench_s_limit_trips_before_the_limit_is_passed(period, start):
    """A drive that gives the bench's whole current unasked, in the least favourable actuator, one phase taking all."""
    rig = HeatedRig(Plant.inside(WORST), start, period)
    assert not rig.follow([(0.301, 0.0, 0.0, None)])  # the guard has just looked
    rig.shaft.read = lambda: (29.9, 0.0, rig.shaft.angle)
    rig.pass_time(period)
    assert rig.follow([(10.0, 0.0, 0.0, None)])
    rig.pass_time(STEP_S)
    assert start < rig.peak <= 130.0
    rig.drive.close()


@pytest.mark.parametrize("start", [100.0, 118.0])
def test_a_trip_leaves_time_for_a_drive_that_hears_no_stop(start):
    rig = HeatedRig(Plant.inside(WORST), start, 0.001)
    assert rig.follow([(10.0, 0.0, 0.0, 25.0)])
    for _ in range(round(SETTINGS.reserve_s / 0.001)):
        rig.pass_time(0.001)
    assert 126.0 < rig.peak <= 130.0
    rig.drive.close()


def test_a_current_that_is_not_known_counts_as_the_bench_s_limit():
    rig = HeatedRig(Plant.inside(WORST), 28.0, 0.001)
    rig.follow([(0.3, 0.0, 0.0, None)])
    current = [channel.quantity for channel in rig.drive.loop_channels].index("q_axis_current")
    rig.far.frozen = True  # no answer: every reading of the exchange is no number
    rig.shaft.read = lambda: (29.9, 0.0, 0.0)
    assert not rig.follow([(0.6, 0.0, 0.0, None)])
    assert math.isnan(rig.drive.values[current])
    assert rig.state[:3].max() > 40.0
    assert rig.guard.hottest["test"] + 5.0 >= rig.state[:3].max()  # heat since the last step is not told yet
    rig.supervisor.make_safe()
    rig.pass_time(STEP_S)  # the plant is up to a step behind
    assert rig.guard.node_bounds["test"][HOTTEST] >= rig.state[:3].max()


def test_a_loop_that_stalls_counts_what_flowed_before_it():
    rig = HeatedRig(Plant.inside(WORST), 28.0, 0.001)
    rig.follow([(0.5, 0.0, 0.0, 25.0)])
    rig.pass_time(0.8)
    rig.shaft.read = lambda: (0.0, 0.0, 0.25)
    rig.follow([(0.6, 0.0, 0.0, None)])
    assert rig.state[:3].max() > 45.0
    assert rig.guard.hottest["test"] >= rig.state[:3].max()


@pytest.mark.parametrize("seconds", [0.05, 0.3, 0.7])
def test_runs_shorter_than_a_step_of_the_guard_are_not_forgotten(seconds):
    """Ten short runs one after the other, each from the bounds that the last one left."""
    state, nodes = np.full(4, 28.0), np.full(3, 28.0)
    for _ in range(10):
        rig = HeatedRig(Plant.inside(WORST), 28.0, 0.001)
        rig.state = state
        rig.guard._bound.set(np.stack([nodes, nodes], axis=1))
        if rig.follow([(seconds, 0.0, 0.0, 25.0)]):
            break
        rig.supervisor.make_safe()
        state, nodes = rig.state, rig.guard.node_bounds["test"]
        assert nodes[HOTTEST] >= state[:3].max()
        assert nodes[HOTTEST] >= state[3]
    assert rig.peak <= 130.0
    assert rig.peak > 35.0


def test_the_time_left_is_what_a_plant_at_the_worst_of_its_box_would_have():
    guard = guard_of(start=28.0)
    guard.begin(0.0)
    assert guard.time_left() == {"test": math.inf}
    guard.flowing[0] = 28.0**2
    assert 4.0 < guard.time_left()["test"] < 5.6  # 27.96 A are carried for 5 s from there, see `thermal limits`
    guard.flowing[0] = 8.0**2
    assert guard.time_left() == {"test": math.inf}
    assert guard.hottest["test"] == 28.0


# -- what keeps step with the rotor or with the samples ---------------------------------------------------------------


def against_a_plant(period, seconds, current, angle, parts=20):
    """Bound and truth of a plant at the worst of its box, in the worst angle of commutation, whose current and angle
    are these functions of time, sampled every `period`.
    """
    guard, plants = ready(start=28.0), [Plant.inside(WORST, offset) for offset in np.linspace(0.0, np.pi, 13)]
    states = [np.full(4, 28.0) for _ in plants]
    now, over, peak = 0.0, -math.inf, 28.0
    while now < seconds:
        times = now + period * (np.arange(parts) + 0.5) / parts
        flows = current(times)
        states = [
            finely(plant, state, flows, angle(times), period / parts)
            for plant, state in zip(plants, states, strict=True)
        ]
        now += period
        at = angle(np.array([now, now + 1e-6]))
        flowed = math.sqrt(float(np.mean(flows**2)))
        passed(guard, period, {0: flowed}, (float(at[0]), float(np.diff(at)[0] / 1e-6)))
        if now >= guard.due:
            assert guard.check(now) == ""
            truth = max(float(state[:3].max()) for state in states)
            peak = max(peak, truth)
            if guard.advanced == now:
                over = max(over, truth - guard.hottest["test"])
    return over, peak


def finely(plant, state, currents, angles, seconds):
    """A plant's state after a short time in which current and angle change more than it does."""
    middle = 41.0 * angles + plant.offset + 2.0 * np.pi / 3.0 * np.arange(3)[:, None]
    share = ((1.0 + np.cos(2.0 * middle)) * currents**2).sum(axis=1) / 3.0 * plant.current_gain**2 * seconds
    phases, housing = state[:3], state[3]
    heat = share * plant.phase_resistance * (1.0 + plant.resistance_coefficient * (phases - 25.0))
    time = seconds * len(currents)
    to_housing = (phases - housing) / (3.0 * plant.winding_housing_resistance) * time
    to_air = (phases - plant.ambient) / (3.0 * plant.winding_ambient_resistance) * time
    out = (housing - plant.ambient) / plant.housing_ambient_resistance * time
    fresh = state.copy()
    fresh[:3] += (heat - to_housing - to_air) / (plant.winding_capacitance / 3.0)
    fresh[3] += (to_housing.sum() - out) / plant.housing_capacitance
    return fresh


HALF = math.pi / LEA.pole_pairs  # rad, of the rotor in half an electrical turn


def detents(period, halves=1.0):
    """Half electrical turns in the first 8 ms of every period, as fast as the bench's current allows, then rest."""

    def angle(times):
        whole, part = np.divmod(times / period, 1.0)
        moved = np.clip(part * period / 0.008, 0.0, 1.0)
        return HALF * halves * (whole + np.where(moved < 0.5, 2.0 * moved**2, 1.0 - 2.0 * (1.0 - moved) ** 2))

    return angle


def steady(times):
    return np.full_like(times, 18.0)


COURSES = {  # s between samples, current [A] and angle [rad] over time [s]
    "a current that goes with the angle": (0.001, lambda t: 12.0 + 8.0 * np.cos(82.0 * 7.0 * t), lambda t: 7.0 * t),
    "detents at 20 Hz": (0.05, steady, detents(0.05)),
    "three detents at once at 20 Hz": (0.05, steady, detents(0.05, 3.0)),
    "detents at 100 Hz": (0.01, steady, detents(0.02)),
    "detents at 500 Hz": (0.002, steady, detents(0.016)),
    "detents at 1 kHz": (0.001, steady, detents(0.016)),
    "a speed that swings with the angle": (0.001, steady, lambda t: 7.0 * t + 0.9 / 82.0 * np.sin(82.0 * 7.0 * t)),
}


@pytest.mark.parametrize("course", list(COURSES))
def test_what_keeps_step_with_the_rotor_or_the_samples_is_no_hotter_than_the_bound(course):
    period, current, angle = COURSES[course]
    over, peak = against_a_plant(period, 6.0, current, angle)
    assert over <= 0.05
    assert peak > 40.0


def test_the_shares_that_the_pages_tell_are_those_of_the_code():
    text = (Path(__file__).parents[2] / "docs" / "explanation" / "thermal.md").read_text()
    match = re.search(
        r"LEA ([\d.]+) % of the heat at 1 kHz, (\d+) % at 500 Hz, and all of it.*?below (\d+) Hz", text, re.S
    )
    at_1_khz = 1e-6 * detour(LEA, largest_acceleration([LEA], SETTINGS.most_current, SETTINGS.most_speed))
    assert [float(number) for number in match.groups()] == [
        round(100.0 * at_1_khz, 1),
        round(400.0 * at_1_khz),
        round(1000.0 * math.sqrt(at_1_khz)),
    ]


def test_a_supply_that_is_switched_on_late_in_a_step_counts_as_late():
    """A cold guard advances once a second, and looks ten times as often; the current comes just after a look."""
    guard = ready()
    plants = [np.full(4, 28.0)]
    plant, now, over, current = Plant.inside(WORST), 0.0, -math.inf, 0.0
    guard.undriven = frozenset([0])
    for _ in range(420):
        now += STEP_S
        guard.leads[0] = 2.0 * current**2
        plants.append(led(plant, plants[-1], current))
        if now >= guard.due:
            assert guard.check(now) == ""
            if guard.advanced == now:
                over = max(over, plants[-1][:3].max() - guard.hottest["test"])
            current = 20.0 if now > 1.6 else 0.0
    assert plants[-1][:3].max() > 33.0
    assert over <= 0.0


def led(plant, state, current):
    """A plant after a fine step with a direct current through two of its phases, each of which it heats by R I^2."""
    phases, housing = state[:3], state[3]
    resistance = plant.phase_resistance * (1.0 + plant.resistance_coefficient * (phases - 25.0))
    heat = np.array([1.0, 1.0, 0.0]) * resistance * (current * plant.current_gain) ** 2
    to_housing = (phases - housing) / (3.0 * plant.winding_housing_resistance)
    to_air = (phases - plant.ambient) / (3.0 * plant.winding_ambient_resistance)
    out = (housing - plant.ambient) / plant.housing_ambient_resistance
    rates = np.append((heat - to_housing - to_air) / (plant.winding_capacitance / 3.0), 0.0)
    rates[3] = (to_housing.sum() - out) / plant.housing_capacitance
    return state + STEP_S * rates


def test_the_slower_of_two_rotors_on_a_shaft_is_accelerated_by_the_faster_one():
    strong = LEA.model_copy(update={"torque_constant": 3.0 * LEA.torque_constant})
    both, own, other = (largest_acceleration(motors, 30.0, 40.0) for motors in ([LEA, strong], [LEA], [strong]))
    assert own < other == both


def test_the_path_by_the_velocity_has_a_gap_where_it_is_not_known_or_was_not_looked_at():
    """Spans on either side of a gap are not joined: nothing tells how two angles of theirs stand to each other."""
    rotor = Rotor(LEA, 40.0, 0.0)

    def passes(angle=0.0, velocity=7.0):
        rotor.span(np.array([[0.001, 0.2, 0.0, 7.0], [0.001, 0.2, angle, velocity], [0.001, 0.2, 0.0, 7.0]]), 0.003)
        return rotor.path_has_gap

    assert passes()  # nothing is known of what was before
    assert not passes()
    assert not passes(angle=math.nan)
    assert passes(velocity=math.nan)
    assert not passes()
    rotor.loose_span(1e-6, [7.0], 0.001)
    assert rotor.path_has_gap
    assert passes()
    assert not passes()
