"""Plans under the bound before anything moves: what is refused, what waits help, and how it compares to a run."""

import math
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.driver.contract import Mode
from leactl.errors import InputError
from leactl.protocol.plan import (
    Constant,
    EndWhen,
    Engage,
    Plan,
    Ramp,
    Samples,
    Segment,
    SoughtSetpoint,
    StepOutcome,
    Until,
    When,
)
from leactl.runner.operators import confirm_at_once
from leactl.runner.request import prepare
from leactl.runner.session import execute
from leactl.runner.thermal_admission import Windings
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.demand import states
from leactl.safety.thermal.foresight import Foresight
from tests.safety.guards import LEA, SETTINGS

BOTH = {"test": LEA, "load": LEA}


def made(*actions, setup="locked", rate=100.0):
    return Plan("p", "", setup, "", rate, rate, {}, "", tuple(actions), (), "")


def held(seconds, name="hold", **setpoints):
    return Segment(name, seconds, 0.0, {role: Constant(value) for role, value in setpoints.items()}, {})


def foresight(start=28.0, motors=BOTH):
    return Foresight(motors, SETTINGS, {role: np.full(3, start) for role in motors})


CURRENT = Engage({"test": Mode.CURRENT})
BURST = [held(0.0, "to 25", test=25.0), held(4.0, "burst", test=25.0), held(0.0, "to 0", test=0.0)]
REST = held(1.0, "rest", test=0.0)


def test_a_plan_that_passes_is_named_with_step_time_and_role():
    plan = made(CURRENT, held(2.0, "mild", test=5.0), held(60.0, "hot", test=25.0))
    passing = foresight().forecast(plan).passing
    assert (passing.step, passing.role, passing.action) == ("hot", "test", 2)
    assert 2.0 + 4.0 < passing.time_s < 2.0 + 9.0
    load = foresight().forecast(made(Engage({"load": Mode.CURRENT}), held(60.0, "hot", load=25.0)))
    assert load.passing.role == "load"
    assert load.peaks["test"] < 29.0


def test_a_plan_that_passes_nowhere_tells_its_peaks():
    result = foresight().forecast(made(CURRENT, *BURST))
    assert result.passing is None
    assert 80.0 < result.peaks["test"] < 129.5
    assert result.peaks["load"] == pytest.approx(28.0, abs=0.01)


def test_a_start_at_the_limit_may_cool_and_carries_nothing():
    assert foresight(130.0).forecast(made(CURRENT, REST)).passing is None
    assert foresight(130.0).forecast(made(CURRENT, held(5.0, test=10.0))).passing.time_s < 0.8


def waits(plan):
    return [(place, action) for place, action in enumerate(plan.actions) if getattr(action, "name", "") == "cooldown"]


@pytest.mark.parametrize(
    ("start", "bursts"),
    [pytest.param(*drawn, marks=pytest.mark.long) for drawn in ((28.0, 3), (60.0, 2), (100.0, 2))],
)
def test_a_plan_with_waits_passes_nowhere_and_waits_no_longer_than_it_must(start, bursts):
    plan = made(CURRENT, *[REST, *BURST] * bursts)
    sight = foresight(start)
    assert sight.forecast(plan).passing is not None
    longer, found = sight.with_waits(plan)
    assert found.passing is None
    assert sight.forecast(longer).passing is None
    assert [action for action in longer.actions if getattr(action, "name", "") != "cooldown"] == list(plan.actions)
    assert waits(longer)
    for place, wait in waits(longer):
        asked = [a.setpoints["test"].value for a in longer.actions[1:place] if "test" in getattr(a, "setpoints", {})]
        assert asked[-1:] in ([], [0.0])
        # shorter by the rounding and 5 %, it would not do: the plan passes in the burst that this wait is for
        less = Segment("cooldown", 0.95 * wait.duration_s - 5.0, 0.0, {}, {})
        if less.duration_s > 0.0:
            following = min([later for later, _wait in waits(longer) if later > place], default=len(longer.actions))
            cut = made(*longer.actions[:place], less, *longer.actions[place + 1 : following])
            assert sight.forecast(cut).passing is not None


@pytest.mark.long
def test_no_wait_stands_where_current_or_speed_is_asked_for():
    busy = made(CURRENT, *BURST, held(2.0, "low", test=3.0), *BURST)
    longer, found = foresight().with_waits(busy)
    assert found.passing is None or not waits(longer)
    for place, _wait in waits(longer):
        before = [a.setpoints["test"].value for a in longer.actions[1:place] if a.setpoints]
        assert before[-1:] in ([], [0.0])
    spun = made(Engage({"test": Mode.VELOCITY}), held(0.0, "to", test=35.0), held(3600.0, test=35.0), setup="free")
    longer, _found = foresight(motors={"test": LEA}).with_waits(spun)
    assert all(place <= 1 for place, _wait in waits(longer))


def test_what_no_wait_can_help_stays_as_it_is():
    plan = made(CURRENT, held(60.0, "hot", test=25.0))
    longer, found = foresight().with_waits(plan)
    assert longer == plan
    assert found.passing.step == "hot"


HOT = """
name: hot
setup: locked
rate_Hz: 50
steps:
  - mode: {test: current}
  - hold: {role: test, current_A: 25, duration_s: 60}
"""


@pytest.fixture
def at_the_bench(tmp_path, monkeypatch):
    """Requests for the shipped emulated bench."""
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))

    def request(text):
        path = tmp_path / "protocol.yaml"
        path.write_text(text)
        return prepare(str(path), "emulated", ("seed=5",), "", "design", "", tmp_path / "runs", False)

    return request


@pytest.mark.parametrize("insert", [False, pytest.param(True, marks=pytest.mark.long)])
def test_a_hopeless_plan_is_refused_with_that_word(at_the_bench, insert):
    made = at_the_bench(HOT)
    windings = Windings(made.bench, made.devices, emulated_here=True)
    with pytest.raises(InputError) as refused:
        windings.admit(made.plan, insert)
    words = str(refused.value)
    assert "may take the test winding to its limit of 130 degC after " in words
    assert ("no wait helps" if insert else "no wait between its steps helps: shorten or lower them") in words
    assert "\n" not in words


# -- currents that are not planned -------------------------------------------------------------------------------------


def warmed(plan, role="test", motors=BOTH):
    sight = foresight(motors=motors)
    return sight.forecast(plan).peaks[role]


def squares(plan, motors=BOTH):
    """Mean square currents of both roles in the last action, as foresight takes them to be."""
    sight = foresight(motors=motors)
    *before, state = states(plan)
    for earlier in before:
        list(sight._pieces(plan, earlier))
    result = next(sight._pieces(plan, state)).squares
    return dict(zip(motors, result.tolist(), strict=True))


def friction(speed, end="high"):
    box = Box.of(LEA)
    return getattr(box.coulomb_friction, end) + getattr(box.viscous_damping, end) * speed


def test_a_free_drive_at_speed_needs_its_own_friction():
    plan = made(Engage({"test": Mode.VELOCITY}), held(0.0, test=20.0), held(5.0, test=20.0), setup="free")
    assert squares(plan)["test"] == pytest.approx((friction(20.0) / 0.49) ** 2)


@pytest.mark.parametrize(
    ("driving", "speed", "needed"),
    [
        (-6.0, 20.0, 6.0 + 2.0 * friction(20.0) / 0.49),
        (6.0, -20.0, 6.0 + 2.0 * friction(20.0) / 0.49),
        (6.0, 20.0, 6.0 - 2.0 * friction(20.0, "low") / 0.49),
        (1.0, 20.0, 2.0 * friction(20.0) / 0.49 - 1.0),
        (6.0, 0.01, 6.0 + 2.0 * friction(0.01) / 0.49),
    ],
)
def test_a_coupled_drive_at_speed_bears_the_other_one_s_torque_and_the_friction_of_both(driving, speed, needed):
    """Friction helps to hold what drives the shaft onward; a shaft that hardly turns may stick either way."""
    modes = Engage({"test": Mode.CURRENT, "load": Mode.VELOCITY})
    plan = made(modes, held(0.0, test=driving, load=speed), held(5.0, test=driving, load=speed), setup="coupled")
    assert squares(plan)["load"] == pytest.approx(needed**2)
    assert squares(plan)["test"] == pytest.approx(driving**2)


@pytest.mark.parametrize("mode", [Mode.ANGLE, Mode.VELOCITY])
def test_a_shaft_at_rest_keeps_its_strain_until_the_other_drive_overcomes_friction(mode):
    """Pushed from 0 to 9 A friction carries its part; let go to 8 A, less than twice friction, all stays as it is."""
    modes, least = Engage({"test": Mode.CURRENT, "load": mode}), 2.0 * friction(0.0, "low") / 0.49
    pushed = [modes, held(0.0, test=-9.0), held(5.0, test=-9.0)]
    assert squares(made(*pushed, setup="coupled"))["load"] == pytest.approx((9.0 - least) ** 2)
    eased = [*pushed, held(0.0, test=-8.5), held(5.0, test=-8.5)]
    assert squares(made(*eased, setup="coupled"))["load"] == pytest.approx((9.0 - least) ** 2)
    let_go = [*pushed, held(0.0, test=-2.0), held(5.0, test=-2.0)]
    assert squares(made(*let_go, setup="coupled"))["load"] == pytest.approx((2.0 + 2.0 * friction(0.0) / 0.49) ** 2)


def test_a_shaft_that_comes_to_rest_may_stick_either_way():
    modes = Engage({"test": Mode.CURRENT, "load": Mode.ANGLE})
    plan = made(modes, held(0.0, test=-9.0), held(1.0, test=-9.0, load=0.5), held(5.0, test=-9.0), setup="coupled")
    assert squares(plan)["load"] == pytest.approx((9.0 + 2.0 * friction(0.0) / 0.49) ** 2)
    modes = Engage({"test": Mode.CURRENT, "load": Mode.VELOCITY})
    turning = [held(0.0, test=-9.0, load=20.0), held(1.0, test=-9.0, load=20.0)]
    plan = made(modes, *turning, held(0.0, test=-9.0, load=0.0), held(5.0, test=-9.0, load=0.0), setup="coupled")
    assert squares(plan)["load"] == pytest.approx((9.0 + 2.0 * friction(0.0) / 0.49) ** 2)


def test_a_drive_that_gains_speed_needs_current_for_the_inertia():
    ramp = Segment("up", 0.2, 0.0, {"test": Ramp(0.0, 20.0, 0.2)}, {})
    plan = made(Engage({"test": Mode.VELOCITY}), ramp, setup="free")
    assert squares(plan)["test"] > (friction(9.5) / 0.49 + 0.9 * 0.0024 * 100.0 / 0.49) ** 2
    swing = 0.3 * np.sin(2.0 * np.pi * 4.0 * np.arange(200) / 100.0)
    plan = made(
        Engage({"test": Mode.ANGLE}),
        Segment("swing", 2.0, 0.0, {"test": Samples(0.01, swing)}, {}),
        setup="free",
    )
    inertia = 0.0024 * 0.3 * (2.0 * math.pi * 4.0) ** 2 / 0.49
    assert squares(plan)["test"] > (friction(0.0) / 0.49 + 0.9 * inertia) ** 2


def test_a_fast_swing_heats_with_its_mean_square_and_not_with_its_peak():
    rate, amplitude = 2.0 * math.pi * 30.0, 12.0 * 0.49 / 0.0024 / (2.0 * math.pi * 30.0) ** 2
    swing = Segment("swing", 1.0, 0.0, {"test": Samples(1e-3, amplitude * np.sin(rate * np.arange(1001) / 1000))}, {})
    result = squares(made(Engage({"test": Mode.ANGLE}), swing, setup="free", rate=1000.0))["test"]
    resisting = friction(amplitude * rate) / 0.49
    assert result == pytest.approx(72.0 + 2.0 * resisting * 12.0 * 2.0 / math.pi + resisting**2, rel=0.08)


def test_a_jump_of_the_speed_heats_for_as_long_as_the_largest_current_takes_for_it():
    """20 rad/s need 0.098 A s, at 30 A that is 3.3 ms; in one sample of the list they would be 98 A."""
    listed = Samples(0.001, np.where(np.arange(1000) < 50, 0.0, 20.0))
    plan = made(
        Engage({"test": Mode.VELOCITY}), Segment("jump", 1.0, 0.0, {"test": listed}, {}), setup="free", rate=1e3
    )
    impulse = 0.0024 * 20.0 / 0.49
    assert squares(plan)["test"] >= 30.0 * impulse / 0.1
    assert squares(plan)["test"] == pytest.approx(30.0 * impulse / 0.1 + (friction(20.0) / 0.49) ** 2, rel=0.05)


def test_no_current_is_taken_to_be_more_than_the_bench_lets_pass():
    modes = Engage({"test": Mode.CURRENT, "load": Mode.VELOCITY})
    plan = made(modes, held(0.0, test=-30.0, load=38.0), held(1.0, test=-30.0, load=38.0), setup="coupled")
    assert squares(plan)["load"] == pytest.approx(SETTINGS.most_current**2)


def test_a_locked_rotor_stands_and_one_that_crawls_or_turns_is_cooler():
    hold = [held(0.0, test=12.0), held(20.0, test=12.0)]
    locked = warmed(made(CURRENT, *hold, rate=1000.0))
    modes = Engage({"test": Mode.CURRENT, "load": Mode.VELOCITY})
    turning, crawling, creeping = (
        warmed(made(modes, held(0.0, load=speed), *hold, setup="coupled", rate=1000.0)) for speed in (5.0, 0.2, 0.002)
    )
    assert turning < crawling < locked - 10.0
    assert creeping == pytest.approx(locked, abs=1.0)


def test_a_rotor_that_a_slow_loop_cannot_follow_stands_and_the_rate_that_would_is_told():
    hold = [held(0.0, test=12.0), held(20.0, test=12.0)]
    modes = Engage({"test": Mode.CURRENT, "load": Mode.VELOCITY})
    locked = warmed(made(CURRENT, *hold))
    plan = made(modes, held(0.0, load=5.0), *hold, setup="coupled")
    assert warmed(plan) == pytest.approx(locked, abs=1.0)
    rate = foresight().forecast(plan).turning_from_hz
    faster = replace(plan, rate_Hz=rate)
    assert foresight().forecast(faster).turning_from_hz is None
    assert warmed(faster) < locked - 8.0
    assert foresight().forecast(made(CURRENT, *hold)).turning_from_hz is None  # a locked one stands at any rate


def test_a_current_that_may_keep_step_with_a_rotor_counts_as_if_it_did():
    """A list at the loop's rate: once even, once on and off as often as a pole passes."""
    modes = Engage({"test": Mode.CURRENT, "load": Mode.VELOCITY})

    def listed(low, high):
        times = np.arange(5000) / 1000.0
        values = np.where(np.cos(82.0 * 7.0 * times) > 0.0, high, low)
        swings = Segment("s", 5.0, 0.0, {"test": Samples(0.001, values)}, {})
        return made(modes, held(0.0, load=7.0), swings, setup="coupled", rate=1000.0)

    even, keeping = warmed(listed(14.0, 14.0)), warmed(listed(0.0, 14.0 * math.sqrt(2.0)))
    assert keeping > even + 5.0


def test_setpoints_that_alternate_faster_than_parts_of_a_step_are_all_counted():
    """20 A and 0 A in turn at 1 kHz: any coarse comb could meet the zeros alone."""
    for first in (0, 1):
        listed = Samples(0.001, np.where(np.arange(4000) % 2 == first, 20.0, 0.0))
        plan = made(CURRENT, Segment("comb", 4.0, 0.0, {"test": listed}, {}), rate=1000.0)
        assert squares(plan)["test"] == pytest.approx(200.0, rel=0.01)


def test_a_duration_that_no_step_divides_evenly_is_followed_to_its_end():
    for tenths in range(1, 60):
        ramp = Segment("up", 0.1 * tenths, 0.0, {"test": Ramp(0.0, 2.0, 0.1 * tenths)}, {})
        assert foresight().forecast(made(Engage({"test": Mode.VELOCITY}), ramp, setup="free")).passing is None


# -- against the guard of a run ----------------------------------------------------------------------------------------

LOCKED = """
name: bursts
setup: locked
rate_Hz: 50
steps:
  - mode: {test: current}
  - hold: {role: test, current_A: 20, duration_s: 4}
  - hold: {role: test, current_A: 0, duration_s: 2}
  - ramp: {role: test, to_current_A: -18, rate_A_s: 9}
  - hold: {role: test, current_A: -18, duration_s: 2}
"""
CRAWLING = """
name: crawl
setup: coupled
rate_Hz: 50
steps:
  - mode: {test: current, load: velocity}
  - ramp: {role: load, to_velocity_rad_s: 0.2, rate_rad_s2: 1}
  - ramp: {role: test, to_current_A: 10, rate_A_s: 40}
  - hold: {role: test, current_A: 10, duration_s: 25}
"""
SPINNING = """
name: spin
setup: coupled
rate_Hz: 50
steps:
  - mode: {test: current, load: velocity}
  - ramp: {role: load, to_velocity_rad_s: 25, rate_rad_s2: 50}
  - ramp: {role: test, to_current_A: 8, rate_A_s: 40}
  - hold: {role: test, current_A: 8, duration_s: 12}
"""


@pytest.mark.parametrize(("text", "above"), [(LOCKED, 60.0), (CRAWLING, 38.0), (SPINNING, 33.0)])
def test_no_forecast_is_cooler_than_what_the_guard_of_the_run_finds(at_the_bench, monkeypatch, text, above):
    results = []

    class Seen(Windings):
        def __init__(self, *args):
            super().__init__(*args)
            results.append(self)
            self.peaks = dict.fromkeys(self.motors, -math.inf)
            judge = self.guard._judge

            def judged(speeds):
                cause = judge(speeds)
                self.peaks = {role: max(peak, self.guard.hottest[role]) for role, peak in self.peaks.items()}
                return cause

            self.guard._judge = judged

    monkeypatch.setattr("leactl.runner.session.Windings", Seen)
    request = at_the_bench(text)
    outcome = execute(request, confirm_at_once, lambda _progress: nullcontext())
    assert outcome.status == "complete", outcome.reason
    [windings] = results
    peaks = windings.forecast(request.plan).peaks
    assert max(windings.peaks.values()) > above
    for role, peak in windings.peaks.items():
        assert peak <= peaks[role] + 0.2, (role, peak, peaks[role])  # noise of the reading heats as well
    assert max(peaks.values()) - 28.0 < 2.5 * (max(windings.peaks.values()) - 28.0)


# -- holds that end by a criterion -------------------------------------------------------------------------------------


def ended(plan, *lengths):
    """The plan as one course of it: holds with a criterion last so long."""
    rest = iter(lengths)
    return replace(
        plan,
        actions=tuple(
            replace(action, duration_s=next(rest), until=None) if getattr(action, "until", None) else action
            for action in plan.actions
        ),
    )


def until(window):
    return Until("velocity", "test", "mean", window, 1.0, math.inf, required=False)


def test_a_rest_that_may_end_early_is_no_rest_to_rely_on():
    rest = held(120.0, "rest", test=0.0)
    plan = made(CURRENT, *BURST, replace(rest, until=until(1.0)), *BURST)
    assert foresight().forecast(ended(plan, 120.0)).passing is None
    assert foresight().forecast(plan).passing.step == "burst"


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.0, 14.0), st.floats(3.0, 30.0), st.floats(0.0, 1.0)), min_size=2, max_size=4),
)
def test_every_course_stays_below_the_forecast_of_the_plan(holds):
    steps = [replace(held(seconds, test=current), until=until(2.0)) for current, seconds, _share in holds]
    plan = made(CURRENT, *steps)
    lengths = [2.0 + share * (seconds - 2.0) for _current, seconds, share in holds]
    forecast, course = foresight().forecast(plan), foresight().forecast(ended(plan, *lengths))
    if forecast.passing is None:
        assert course.passing is None
        assert course.peaks["test"] <= forecast.peaks["test"] + 0.1  # K, of steps that lie otherwise


# -- searches and conditions -------------------------------------------------------------------------------------------

MAYBE = When(StepOutcome("search", "bracketed"))


def course_of(plan, currents, done):
    """One course of a plan: trials at these currents, and the steps under each condition done or left out."""
    chosen, decided, kept, out = iter(currents), iter(done), [], 0
    for action in plan.actions:
        if isinstance(action, When):
            out += 1 if out else not next(decided)
        elif isinstance(action, EndWhen):
            out -= 1 if out else 0
        elif not out:
            sought = [
                profile for profile in getattr(action, "setpoints", {}).values() if isinstance(profile, SoughtSetpoint)
            ]
            changed = {"test": Constant(next(chosen))} if sought else None
            kept.append(replace(action, setpoints=changed) if changed else action)
    return replace(plan, actions=tuple(kept))


@settings(max_examples=25, deadline=None)
@given(
    st.tuples(st.floats(-16.0, 16.0), st.floats(-16.0, 16.0)),
    st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4),
    st.lists(st.booleans(), min_size=2, max_size=2),
    st.sampled_from([Mode.ANGLE, Mode.VELOCITY, Mode.OFF]),
)
def test_every_course_of_a_search_stays_below_the_forecast_of_the_plan(ends, shares, done, mode):
    low, high = sorted(ends)
    trial = Segment("search", 3.0, 0.0, {"test": SoughtSetpoint(low, high)}, {})
    trials = [trial, held(0.5, "rest", test=0.0)]
    plan = made(
        Engage({"test": Mode.CURRENT, "load": mode}),
        *trials,
        MAYBE,
        *trials,
        MAYBE,
        *trials,
        EndWhen(),
        EndWhen(),
        *trials,
        held(2.0, "behind", test=4.0),
        setup="locked" if mode is Mode.OFF else "coupled",
    )
    course = course_of(plan, [low + share * (high - low) for share in shares], done)
    forecast, taken = foresight().forecast(plan), foresight().forecast(course)
    if forecast.passing is None:
        assert taken.passing is None
        for role in BOTH:
            assert taken.peaks[role] <= forecast.peaks[role] + 0.1  # K, of steps that lie otherwise


@pytest.mark.parametrize("ends", [(0.0, 12.0), (-12.0, 1.0), (-12.0, 12.0)])
def test_a_trial_heats_as_the_end_that_is_further_from_zero(ends):
    at_an_end = foresight().forecast(made(CURRENT, held(5.0, test=12.0))).peaks["test"]
    sought = Segment("search", 5.0, 0.0, {"test": SoughtSetpoint(*ends)}, {})
    assert foresight().forecast(made(CURRENT, sought)).peaks["test"] == pytest.approx(at_an_end)


@pytest.mark.parametrize("away", [-9.0, 9.0])
def test_a_drive_that_holds_against_a_search_takes_what_either_end_asks(away):
    """Which end is the worse one for the load depends on what friction carries already."""
    modes = Engage({"test": Mode.CURRENT, "load": Mode.ANGLE})
    before = [modes, held(0.0, test=away), held(2.0, test=away)]

    def load(profile):
        tried = Segment("search", 5.0, 0.0, {"test": profile}, {})
        return foresight().forecast(made(*before, tried, held(5.0, test=0.0), setup="coupled")).peaks["load"]

    ends = [load(Constant(-8.0)), load(Constant(7.0))]
    assert load(SoughtSetpoint(-8.0, 7.0)) >= max(ends) - 1e-9


def test_a_rest_that_may_be_left_out_is_no_rest_to_rely_on():
    rest = held(120.0, "rest", test=0.0)
    plan = made(CURRENT, *BURST, MAYBE, rest, EndWhen(), *BURST)
    assert foresight().forecast(made(CURRENT, *BURST, rest, *BURST)).passing is None
    assert foresight().forecast(plan).passing.step == "burst"


def test_a_wait_stands_where_it_cannot_be_left_out():
    plan = made(CURRENT, *BURST, MAYBE, held(1.0, "rest", test=0.0), EndWhen(), *BURST)
    longer, forecast = foresight().with_waits(plan)
    assert forecast.passing is None
    for done in (True, False):
        assert foresight().forecast(course_of(longer, (), [done])).passing is None


def test_a_wait_for_a_hot_step_under_a_condition_stands_before_it():
    plan = made(CURRENT, *BURST, MAYBE, *BURST, EndWhen())
    longer, forecast = foresight().with_waits(plan)
    assert forecast.passing is None
    assert foresight().forecast(course_of(longer, (), [True])).passing is None


@pytest.mark.long
def test_a_wait_is_not_put_under_a_condition_that_ends_before_the_hot_step():
    let_go = [held(0.0, test=0.0), held(1.0, "rest", test=0.0), held(0.0, test=3.0)]
    plan = made(CURRENT, *BURST, held(0.0, test=3.0), MAYBE, *let_go, EndWhen(), held(4.0, "burst", test=25.0))
    longer, forecast = foresight().with_waits(plan)
    assert forecast.passing is None
    waits = [place for place, action in enumerate(longer.actions) if getattr(action, "name", "") == "cooldown"]
    assert waits
    assert max(waits) < longer.actions.index(MAYBE)


def test_what_a_drive_holds_against_is_known_whether_steps_were_left_out_or_not():
    modes = Engage({"test": Mode.CURRENT, "load": Mode.ANGLE})
    strained = [modes, held(0.0, test=-9.6), held(1.0, test=-9.6), held(0.0, test=-9.0)]
    let_go = [held(0.0, test=0.0), held(0.0, test=-9.0)]
    eased = [held(0.0, test=0.0), held(0.1, test=0.0), held(0.0, test=-9.0), held(0.1, test=-9.0)]
    for steps in (let_go, eased):
        plan = made(*strained, MAYBE, *steps, EndWhen(), held(30.0, test=-9.0), setup="coupled")
        forecast = foresight().forecast(plan).peaks["load"]
        for done in (True, False):
            assert forecast >= foresight().forecast(course_of(plan, (), [done])).peaks["load"] - 1e-9
