"""Bisections and conditions: how they are spread out, their bounds, and what is refused."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from leactl.cli.main import app
from leactl.errors import InputError
from leactl.protocol.plan import EndWhen, SoughtSetpoint, When
from tests.protocol.writing import plan, segments, text

CRITERION = "{quantity: velocity, role: test, window_s: 0.2, above: 1, unit: rad/s}"
ENDS = "from_current_A: 0.1, to_current_A: 0.9, resolution_A: 0.1"


def bisect(ends=ENDS, more="hold_s: 1, settle_s: 0.5", criterion=CRITERION, name="loose"):
    return f"bisect: {{name: {name}, role: test, {ends}, {more}, criterion: {criterion}}}"


def when(condition, *steps):
    return f"when: {{{condition}, steps: [{', '.join(f'{{{step}}}' for step in steps)}]}}"


currents = st.floats(-20, 20).map(lambda value: round(value, 3))


@given(currents, currents, st.floats(1e-3, 1.0, exclude_max=True), st.floats(0.0, 2.0))
def test_every_trial_is_planned_within_the_ends_and_they_suffice_for_the_resolution(first, second, part, rest):
    span = abs(second - first)
    if not span:
        return
    ends = f"from_current_A: {first}, to_current_A: {second}, resolution_A: {part * span!r}"
    result = plan(bisect(ends, f"hold_s: 1, settle_s: 0.5, rest_s: {rest!r}"))
    trials = [segment for segment in segments(result) if segment.trial]
    low, high = min(first, second), max(first, second)
    assert [trial.setpoints["test"].at(0.0) for trial in trials[:2]] == [first, second]
    assert all(trial.setpoints["test"] == SoughtSetpoint(low, high) for trial in trials[2:])
    assert [trial.trial.number for trial in trials] == list(range(1, len(trials) + 1))
    halvings = len(trials) - 2
    assert span / 2**halvings <= part * span * (1 + 1e-6)
    assert halvings == 0 or span / 2 ** (halvings - 1) > part * span * (1 - 1e-6)
    assert result.peaks() == {("test", "q_axis_current_reference"): max(abs(first), abs(second))}
    assert result.duration_s == pytest.approx(len(trials) * (1 + max(rest, 0.01)))
    assert result.adaptive


def test_behind_every_trial_the_current_is_zero():
    result = segments(plan(bisect()))
    assert [segment.name for segment in result] == ["loose", "rest"] * 5
    assert all(rest.setpoints["test"].high == rest.setpoints["test"].low == 0 for rest in result[1::2])
    assert {rest.duration_s for rest in result[1::2]} == {0.01}


def test_a_span_of_a_power_of_two_resolutions_takes_no_trial_more_by_rounding():
    ends = "from_current_A: 0, to_current_A: 1.6, resolution_A: 0.1"
    assert len([segment for segment in segments(plan(bisect(ends))) if segment.trial]) == 2 + 4
    third = "from_current_A: 0, to_current_A: 0.3, resolution_A: 0.1"
    assert len([segment for segment in segments(plan(bisect(third))) if segment.trial]) == 2 + 2


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (bisect("from_current_A: 1, to_current_A: 1, resolution_A: 0.1"), "to_current_A: 1 A: another end"),
        (bisect("from_current_A: 0, to_current_A: 1, resolution_A: 1"), "resolution_A: 1 A: less than the 1 A between"),
        (
            bisect("from_current_A: 0, to_current_A: 1, resolution_A: 1.0e-300"),
            "resolution_A: 1e-300 A: at least 2.33e-10",
        ),
        (bisect("from_current_A: 0, to_current_A: 1, resolution_A: 0"), "resolution_A"),
        (bisect("from_current_A: 0, to_current_A: 1, resolution_A: .nan"), "resolution_A"),
        (bisect("from: 0, to_current_A: 1, resolution_A: 0.1"), "from_current_A"),
        (bisect().replace("role: test", "role: load", 1), "role: load is in velocity mode at this point; current or"),
        (
            bisect(more="hold_s: 0.6, settle_s: 0.5"),
            "criterion.window_s: settle_s and a window of 0.2 s are longer than",
        ),
        (bisect(criterion=CRITERION.replace("0.2", "0.02")), "criterion.window_s: 0.02 s: at least 3 cycles (0.03 s)"),
        (bisect(criterion=CRITERION.replace("rad/s", "rpm")), "criterion.unit: 'rpm': velocity is in rad/s"),
        (bisect(criterion=CRITERION.replace("above: 1, ", "")), "criterion.below: below, above or both were expected"),
    ],
)
def test_a_search_that_cannot_be_is_refused_at_its_key(step, message):
    with pytest.raises(InputError) as error:
        plan(step)
    assert message in str(error.value)
    assert "trial.yaml:9:" in str(error.value)


def test_a_drive_that_is_off_searches_nothing():
    with pytest.raises(InputError, match="role: test is off at this point; current or torque_profile was expected"):
        plan(bisect(), mode="{load: velocity}")


REST = "hold: {name: rest, role: test, current_A: 0, duration_s: 2}"
STEPS = "step: loose, outcome: bracketed"


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ((when(STEPS, REST),), "when.step: 'loose' has no outcome at this point"),
        (
            (bisect(), when("step: losse, outcome: bracketed", REST)),
            "'losse' has no outcome at this point; one of loose",
        ),
        ((bisect(), when("step: loose, outcome: met", REST)), "met: loose ends bracketed or not_identifiable"),
        ((bisect(), when("step: loose", REST)), "when.outcome: is required and missing"),
        ((bisect(), when(f"{STEPS}, unit: A", REST)), "when.unit: either step and outcome, or a reading"),
        ((when("quantity: velocity, above: 1, unit: rad/s", REST),), "when.role: is required and missing"),
        (
            (when("quantity: velocity, role: test, above: 1, unit: rpm", REST),),
            "when.unit: 'rpm': velocity is in rad/s",
        ),
        ((when("quantity: velocity, role: test, unit: rad/s", REST),), "when.below: below, above or both"),
        (
            (bisect(), when(STEPS, REST.replace("_A: 0", "_A: 3"))),
            "test is not left as it was; current at 0, as before",
        ),
        ((bisect(), when(STEPS, "mode: {test: off}")), "test is not left as it was; current at 0, as before"),
        ((bisect(), when(STEPS, "record: {rate_Hz: 10}")), "a record or supply step would outlast the condition"),
        ((bisect(), when(STEPS, "hodl: {duration_s: 1}")), "no such step; hold was expected"),
    ],
)
def test_a_condition_that_cannot_be_is_refused_at_its_key(steps, message):
    with pytest.raises(InputError) as error:
        plan(*steps)
    assert message in str(error.value)


def test_a_condition_encloses_its_steps_and_they_count_as_done():
    result = plan(
        bisect(),
        when(STEPS, "set: {role: test, current_A: 2}", "hold: {duration_s: 7}", "set: {role: test, current_A: 0}"),
    )
    marks = [action for action in result.actions if isinstance(action, When | EndWhen)]
    assert [type(mark) for mark in marks] == [When, EndWhen] * 2
    assert str(marks[2].condition) == "loose is bracketed"
    assert result.duration_s == pytest.approx(5 * 1.01 + 7)
    assert result.peaks()["test", "q_axis_current_reference"] == 2


def test_conditions_nest_and_repeat():
    inner = when("step: loose, outcome: not_identifiable", REST)
    result = plan(f"repeat: {{times: 3, steps: [{{{bisect()}}}, {{{when(STEPS, inner)}}}]}}")
    depth, deepest = 0, 0
    for action in result.actions:
        depth += isinstance(action, When) - isinstance(action, EndWhen)
        deepest = max(deepest, depth)
        assert depth >= 0
    assert (depth, deepest) == (0, 2)


def test_plan_and_check_tell_trials_and_bounds(tmp_path):
    path = tmp_path / "trial.yaml"
    path.write_text(text(bisect(), bisect(name="other"), bisect(name="other")))
    for command in ("check", "plan"):
        shown = CliRunner().invoke(app, ["protocol", command, str(path)])
        assert "bisect loose: 5 trials, test 0.1 .. 0.9 A to 0.1 A, 5 s of trials at most" in shown.output
        assert "5 s of trials at most, 2 times" in shown.output
        assert "at most 0:00:15" in shown.output
    assert "test 0.1 .. 0.9 A, at most 1 s, until mean of test velocity" in shown.output
    shown = CliRunner().invoke(app, ["protocol", "plan", str(path), "--bench", "emulated", "--json"])
    answer = json.loads(shown.output)
    assert len(answer["searches"]) == 2
    assert all(
        25 < answer["hottest_degC"][role] < 60 and math.isfinite(answer["hottest_degC"][role])
        for role in answer["hottest_degC"]
    )


@pytest.mark.parametrize(
    ("limit", "message"),
    [
        (
            "{bisect: losse, low: 0.1, unit: A}",
            "bisect: 'losse' is the name of no bisection; one of loose was expected",
        ),
        ("{bisect: loose, low: 0.1, unit: V}", "unit: 'V': loose is in A; one of A, mA"),
        ("{bisect: loose, unit: A}", "low, high or both were expected"),
    ],
)
def test_a_limit_on_a_search_is_checked(limit, message):
    with pytest.raises(InputError) as error:
        plan(bisect(), more=f"acceptance: [{limit}]")
    assert message in str(error.value)
