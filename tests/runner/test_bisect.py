"""Searches and conditions on the emulated bench: what comes out, and what becomes of those that go wrong midway."""

import math
import signal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from leactl.cli.main import app
from leactl.protocol import protocolfile
from leactl.protocol.plan import Search, SearchLimit, SearchTrial, Segment, SoughtSetpoint, Until
from leactl.runfile.read.bisections import searches
from leactl.runfile.read.reader import Run
from leactl.runner.step_outcomes import Bisection, Outcomes
from leactl.safety.supervisor import Supervisor
from tests.runner.test_pause import GO_ON, PAUSE

HOLDING_A = 0.208 / 0.49  # Coulomb friction over torque constant of the `design` preload
STEP_A = 0.0137  # of the emulated drive: a thousandth of 11.186 A, in the q axis
CRITERION = "{quantity: velocity, role: test, window_s: 0.2, above: 0.08, unit: rad/s}"
BISECT = """
name: search
setup: free
rate_Hz: 100
parameters: {least_A: 0.1, most_A: 0.9, more: 0.5}
steps:
  - mode: {test: current}
  - bisect: {name: loose, role: test, from_current_A: $least_A, to_current_A: $most_A, resolution_A: 0.05, hold_s: 0.8,
             settle_s: 0.5, rest_s: 0.3, otherwise: OTHERWISE, criterion: CRITERION}
  - when: {step: loose, outcome: bracketed, steps: [{hold: {name: after, duration_s: $more}}]}
  - when: {step: loose, outcome: not_identifiable, steps: [{hold: {name: instead, duration_s: $more}}]}
  - mode: {test: "off"}
"""


def search(criterion=CRITERION, otherwise="continue", more=""):
    return BISECT.replace("CRITERION", criterion).replace("OTHERWISE", otherwise) + more


def told(outcome):
    """Steps of a run, its searches, its references with their times, and what the runner told."""
    with Run.open(outcome.path) as run:
        reference = run.channel("q_axis_current_reference", role="test")
        return run.steps, list(searches(run.steps)), reference, [event.message for event in run.events]


# -- the search itself -------------------------------------------------------------------------------------------------


def bisection(first, second, resolution):
    return Bisection(Search("s", "test", "q_axis_current_reference", first, second, resolution, required=False))


@given(st.floats(-20, 20), st.floats(-20, 20), st.floats(1e-3, 0.9), st.floats(0, 1), st.booleans())
def test_the_interval_holds_what_is_searched_and_is_as_narrow_as_asked(first, second, part, where, above):
    span = abs(second - first)
    if span < 1e-3:
        return
    one = bisection(first, second, part * span)
    sought = min(first, second) + where * span
    for _ in range(one.search.trials):
        assert min(first, second) <= one.setpoint <= max(first, second)
        assert one.outcome == "bisecting"
        one.take((one.setpoint > sought) == above)
        if one.outcome == "not_identifiable":
            assert where in (0.0, 1.0) or len(one.met) == 2
            assert all(map(math.isnan, one.bracket))
            return
    low, high = one.bracket
    assert one.outcome == "bracketed"
    assert low - 1e-12 <= sought <= high + 1e-12
    assert high - low <= part * span * (1 + 1e-6)


def test_ends_that_agree_say_so():
    one = bisection(0.0, 1.0, 0.1)
    one.take(False)
    one.take(False)
    assert str(one) == "s: not identifiable, the criterion is not met at both 0 and 1 A"


def test_no_setpoint_beyond_what_was_planned_is_chosen():
    wanted = Search("s", "test", "q_axis_current_reference", 0.0, 9.0, 1.0, required=False)
    until = Until("velocity", "test", "mean", 0.1, 1.0, math.inf, required=False)
    planned = Segment("s", 1.0, 0.0, {"test": SoughtSetpoint(0.0, 1.0)}, {}, until, SearchTrial(wanted, 1))
    outcomes = Outcomes()
    outcomes.take(outcomes.chosen(planned), False)
    with pytest.raises(AssertionError, match="9 is not between 0 and 1"):
        outcomes.chosen(Segment("s", 1.0, 0.0, {"test": SoughtSetpoint(0.0, 1.0)}, {}, until, SearchTrial(wanted, 2)))


@pytest.mark.parametrize(
    ("low", "high", "unit", "met"),
    [(300, 800, "mA", True), (0.5, 0.75, "A", True), (0.0, 0.7, "A", False), (0.6, math.inf, "A", False)],
)
def test_the_whole_interval_has_to_lie_within_its_limit(low, high, unit, met):
    outcomes, one = Outcomes(), bisection(0.0, 1.0, 0.25)
    for outcome in (False, True, False, True):
        one.take(outcome)
    assert one.bracket == (0.5, 0.75)
    outcomes.searches.append(one)
    assert [verdict.met for verdict in outcomes.verdicts([SearchLimit("s", low, high, unit)])] == [met]


def test_a_search_that_was_never_done_keeps_no_limit():
    [verdict] = Outcomes().verdicts([SearchLimit("s", 0.0, 1.0, "A")])
    assert (verdict.met, verdict.summary) == (False, "s was not done, 0 to 1 A was required")


# -- whole runs --------------------------------------------------------------------------------------------------------


def test_the_current_at_which_the_shaft_lets_go_is_bracketed(spin, tmp_path):
    outcome, bench = spin(search())
    assert outcome.status == "complete"
    steps, [answer], reference, events = told(outcome)
    trials = [step for step in steps if step.name == "loose"]
    assert [step.parameters["trial"] for step in trials] == [1, 2, 3, 4, 5, 6]
    assert [step.parameters["until"] for step in trials[:2]] == ["not met", "met"]
    assert answer.outcome == "bracketed"
    assert answer.upper - answer.lower <= 0.05
    assert answer.lower - STEP_A / 2 <= HOLDING_A <= answer.upper + STEP_A / 2
    assert [step.name for step in steps].count("after") == 1
    assert "instead" not in [step.name for step in steps]
    assert "when loose is not_identifiable: left out" in events
    for step in trials:
        inside = (reference.time > step.start + 0.02) & (reference.time < step.stop - 0.02)
        assert reference.values[inside] == pytest.approx(step.parameters["current_A"], abs=STEP_A)
        behind = (reference.time > step.stop + 0.02) & (reference.time < step.stop + 0.28)
        assert not reference.values[behind].any()
    planned = protocolfile.load(str(tmp_path / "protocol.yaml")).duration_s
    assert sum(step.stop - step.start for step in steps) <= planned + 1e-9
    assert bench.far_ends["drive_test"].state == "disabled"
    shown = CliRunner().invoke(app, ["runs", "show", str(outcome.path)])
    assert f"bisect loose: {answer.lower:g} to {answer.upper:g} A, resolution 0.05" in shown.output


@pytest.mark.parametrize("condition", ["design", "loaded"])
def test_the_shipped_search_brackets_what_friction_holds(spin, condition):
    text = protocolfile.load("breakaway").text
    outcome, _bench = spin(text, condition=condition)
    _steps, [forward, backward], _reference, _events = told(outcome)
    holding = {"design": 0.208, "loaded": 0.3037}[condition] / 0.49
    for answer, sign in ((forward, 1), (backward, -1)):
        assert answer.lower - STEP_A / 2 <= sign * holding <= answer.upper + STEP_A / 2
        assert answer.upper - answer.lower <= 0.02


@pytest.mark.parametrize("ends", [("least_A=0.1", "most_A=0.2"), ("least_A=0.7", "most_A=0.9")])
def test_ends_with_the_same_outcome_are_not_identifiable_and_the_protocol_goes_on(spin, ends):
    outcome, _bench = spin(search(), sets=("seed=3", *ends))
    assert outcome.status == "complete"
    steps, [answer], _reference, events = told(outcome)
    assert (answer.outcome, answer.lower) == ("not_identifiable", None)
    names = [step.name for step in steps]
    assert (names.count("loose"), names.count("after"), names.count("instead")) == (2, 0, 1)
    assert any(message.startswith("loose: not identifiable, the criterion is ") for message in events)
    shown = CliRunner().invoke(app, ["runs", "show", str(outcome.path)])
    assert "bisect loose: not identifiable, both ends have the same outcome" in shown.output


def test_ends_with_the_same_outcome_end_the_run_where_an_answer_is_required(spin):
    outcome, bench = spin(search(otherwise="fail"), sets=("seed=3", "most_A=0.2"))
    assert (outcome.status, outcome.error.exit_status) == ("failed", 5)
    assert "loose: not identifiable" in outcome.reason
    assert bench.far_ends["drive_test"].state != "operation enabled"


@pytest.mark.parametrize(("low", "met"), [(0.2, True), (0.43, False)])
def test_a_limit_on_the_interval_is_judged(spin, low, met):
    outcome, _bench = spin(search(more=f"acceptance:\n  - {{bisect: loose, low: {low}, high: 0.8, unit: A}}\n"))
    [verdict] = outcome.verdicts
    assert verdict.met == met
    assert verdict.row["lower"] <= HOLDING_A + STEP_A


def test_a_criterion_that_no_reading_can_judge_ends_the_run(spin):
    """A window of 3 ms holds no three readings of a sensor that gives some hundred a second."""
    criterion = "{quantity: torque, role: test, window_s: 0.003, above: 1.0e-9, unit: N*m}"
    outcome, _bench = spin(search(criterion).replace("rate_Hz: 100", "rate_Hz: 1000").replace("free", "coupled"))
    assert (outcome.status, outcome.error.exit_status) == ("failed", 5)
    assert outcome.reason.startswith("loose: the trial at 0.1 cannot be judged: there are no readings of torque")
    steps, answers, _reference, _events = told(outcome)
    assert not answers
    assert steps[-1].parameters["until"] == "not judged"


def test_a_trial_whose_current_is_scaled_down_is_none_of_its_setpoint(spin, monkeypatch):
    monkeypatch.setattr(Supervisor, "scales", lambda _supervisor, _role: True)
    outcome, _bench = spin(search())
    assert (outcome.status, outcome.error.exit_status) == ("failed", 5)
    assert outcome.reason == "loose: the trial at 0.1 cannot be judged: the winding may not carry its current"


def test_a_criterion_within_the_noise_still_ends_with_an_interval(spin):
    criterion = CRITERION.replace("above: 0.08", "above: 0.0001")
    outcome, _bench = spin(search(criterion), sets=("seed=5", "least_A=-0.9"))
    assert outcome.status == "complete"
    [answer] = told(outcome)[1]
    assert answer.upper - answer.lower <= 0.05
    assert -0.9 <= answer.lower < answer.upper <= 0.9


def test_a_trip_in_the_middle_of_a_trial_latches_and_leaves_no_answer(spin):
    outcome, bench = spin(
        search().replace("window_s: 0.2, above: 0.08", "window_s: 0.3, above: 900"), sets=("seed=3", "most_A=3")
    )
    assert (outcome.status, outcome.error.exit_status) == ("tripped", 3)
    steps, answers, _reference, _events = told(outcome)
    assert not answers
    assert (steps[-1].parameters["trial"], steps[-1].parameters["until"]) == (2, "cut short")
    assert bench.far_ends["drive_test"].state != "operation enabled"


def test_a_person_stops_a_search_in_the_middle_of_a_trial(spin):
    outcome, bench = spin(search(), at=[(2.6, lambda _bench: signal.raise_signal(signal.SIGINT))])
    assert (outcome.status, outcome.error.exit_status) == ("stopped", 4)
    steps, answers, _reference, _events = told(outcome)
    assert not answers
    assert (steps[-1].name, steps[-1].parameters["until"]) == ("loose", "cut short")
    assert bench.far_ends["drive_test"].state != "operation enabled"


def test_a_search_pauses_between_its_trials_and_goes_on_as_if_nothing_had_been(spin):
    through, _bench = spin(search())
    outcome, _bench = spin(search(), at=[(1.5, PAUSE), (6.0, GO_ON)])
    steps, [answer], reference, _events = told(outcome)
    pause = next(step for step in steps if step.name == "pause")
    assert [steps[steps.index(pause) + k].name for k in (-1, 1)] == ["rest", "loose"]
    inside = (reference.time > pause.start + 0.02) & (reference.time < pause.stop)
    assert not reference.values[inside].any()
    assert answer == told(through)[1][0]


@pytest.mark.parametrize(("above", "done"), [(-1.0, True), (5.0, False)])
def test_a_reading_decides(spin, above, done):
    text = search(more="").replace(
        "step: loose, outcome: bracketed", f"quantity: velocity, role: test, above: {above}, unit: rad/s"
    )
    steps, _answers, _reference, events = told(spin(text)[0])
    assert ("after" in [step.name for step in steps]) == done
    assert np.any(
        [
            message.startswith("when test velocity in") and message.endswith("done" if done else "left out")
            for message in events
        ]
    )
