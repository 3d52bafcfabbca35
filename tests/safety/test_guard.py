"""The thermal guard: what it counts as heat, when it trips, what it lets through, and plants that it keeps whole."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl import yamlfile
from leactl.driver.contract import Mode
from leactl.errors import SafetyTrip
from leactl.safety.interlocks import Interlocks
from leactl.safety.supervisor import Axis, Supervisor
from leactl.safety.thermal.bound import HOTTEST, ThermalBound
from leactl.safety.thermal.box import Box
from tests.driver.elmo_bench import ElmoBench
from tests.safety.guards import LEA, SETTINGS, guard_of
from tests.safety.phases import STEP_S, Plant, advance
from tests.safety.rig import LIMITS

PATIENT = """
clock: {jump_s: 10}
loop_overruns: {in_a_row: 10000, share_percent: 99, window_s: 600}
current_disagreement: {for_s: 60}  # of shafts that say what they like
"""
WORST = (1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0)  # resistances high, capacitances low


def fed(guard, seconds, current=0.0, role=0, period=0.01, began=0.0, scaled=False):
    """Cycles with this current in one role, until the guard has a word to say; gives it, and when."""
    now = began
    while now < began + seconds - 1e-9:
        now += period
        flows = min(current, guard.allowed[guard.roles[role]]) if scaled else current
        guard.squares[role] += flows**2 * period
        guard.flowing[role] = flows**2
        cause = guard.check(now) if now >= guard.due else ""
        if cause:
            return cause, now
    return "", now


def ready(start=28.0, turning=(0.0, 0.0), roles=("test",), **changes):
    guard = guard_of(roles, start, replace(SETTINGS, **changes))
    guard.watch(lambda place: turning)
    guard.begin(0.0)
    return guard


@pytest.mark.parametrize("reserve", [0.05, 0.22, 1.0])
def test_a_trip_comes_early_enough_for_a_drive_that_goes_on(reserve):
    guard = ready(start=60.0, reserve_s=reserve, limit=120.0)
    cause, _when = fed(guard, 60.0, current=20.0)
    assert cause.startswith("test winding: its hottest phase may be at ")
    assert f"{reserve:g} s on; the limit is 120 degC" in cause
    bound = ThermalBound([Box.of(LEA)], 25.0)
    bound.set(guard.kept["test"][:, None])
    bound.step(reserve, np.array([400.0]), np.ones(1), np.zeros(1), 25.0, late=0.0)
    assert 116.0 < bound.hottest()[0] <= 120.0


def test_a_longer_reserve_trips_earlier():
    times = [fed(ready(start=60.0, reserve_s=reserve), 60.0, current=20.0)[1] for reserve in (0.02, 0.5, 1.0)]
    assert times[0] > times[1] + 0.3 > times[2] + 0.6


@pytest.mark.parametrize("angle", [math.nan, 0.3])
def test_an_angle_that_is_not_known_follows_the_velocity(angle):
    """Turning spreads the heat over the phases; a rotor of which nothing is known stands."""
    hot = {}
    for turning in ((angle, 8.0), (math.nan, math.nan), (math.nan, 0.0)):
        guard = ready(turning=turning)
        assert fed(guard, 5.0, current=14.0)[0] == ""
        hot[turning] = guard.hottest["test"]
    turned, unknown, stood = hot.values()
    assert unknown >= stood
    if math.isnan(angle):
        assert turned < stood - 8.0
    else:  # an angle that is told counts, whatever the velocity
        assert turned == pytest.approx(stood, abs=0.5)


def test_a_velocity_that_is_not_known_heats_the_housing_by_the_fastest():
    known, unknown = ready(turning=(0.0, 0.0)), ready(turning=(math.nan, math.nan))
    for guard in (known, unknown):
        fed(guard, 60.0)
    friction = 0.9 * (0.208 + 0.0238 * SETTINGS.most_speed) * SETTINGS.most_speed  # W
    assert unknown.kept["test"][2] - known.kept["test"][2] > 0.5 * friction * 60.0 / 469.1


def test_a_clock_that_goes_back_ends_the_run():
    guard = ready()
    assert guard.check(1.0) == ""
    assert "gone backwards" in guard.check(0.99)


@pytest.mark.parametrize("start", [60.0, 120.0, 129.4, 130.0, 150.0])
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
@pytest.mark.parametrize("turning", [(0.0, 0.0), (math.nan, 20.0)])
def test_the_current_that_is_allowed_keeps_the_bound_below_the_limit(period, turning):
    guard = ready(start=100.0, turning=turning)
    cause, _when = fed(guard, 40.0, current=30.0, period=period, scaled=True)
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
    assert 29.0 < guard.estimate["load"] < guard.kept["load"][1] < guard.hottest["load"]


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
    assert rig.guard.kept["test"][HOTTEST] >= rig.state[:3].max()
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
    assert rig.guard.kept["test"][HOTTEST] >= rig.state[:3].max()


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
        state, nodes = rig.state, rig.guard.kept["test"]
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


def test_a_rotor_that_steps_from_one_electrical_angle_to_the_same_counts_as_standing():
    """It is seen at rest at every look, and one electrical half turn further each time."""
    stepping, standing = guard_of(start=28.0), guard_of(start=28.0)
    angle = [0.0]
    stepping.watch(lambda _: (angle[0], 0.0))
    standing.watch(lambda _: (0.0, 0.0))
    for guard in (stepping, standing):
        guard.begin(0.0)
    for step in range(1, 1001):
        angle[0] += math.pi / LEA.pole_pairs
        for guard in (stepping, standing):
            guard.squares[0] += 15.0**2 * 0.01
            guard.flowing[0] = 15.0**2
            assert guard.check(step * 0.01) == ""
    assert stepping.hottest["test"] == pytest.approx(standing.hottest["test"], abs=0.1)
