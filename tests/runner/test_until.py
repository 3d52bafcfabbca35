"""Holds that end by a criterion: the statistic, and whole runs within the planned bounds."""

import signal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.protocol import protocolfile
from leactl.protocol.plan import Until
from leactl.runfile.read.reader import Run
from leactl.runner.criterion import Judge
from tests.runner.conftest import SPIN


def until(statistic, low=-np.inf, high=np.inf, window=1.0):
    return Until("velocity", "test", statistic, window, low, high, required=False)


def course(criterion, times, values, start=0.0):
    """The time at which the criterion is met first, NaN where never, and the latest statistic."""
    judge = Judge(criterion, start)
    for time, value in zip(times, values, strict=True):
        judge.receive(time, value)
        if judge.met(time):
            return time, judge.latest
    return np.nan, judge.latest


@given(st.lists(st.floats(-100, 100), min_size=101, max_size=101), st.sampled_from(["mean", "std", "slope"]))
def test_the_statistic_is_that_of_the_window_however_large_the_mean(values, statistic):
    times, values = np.arange(101) * 0.01, np.array(values) + 1e5
    expected = {"mean": values.mean(), "std": values.std(ddof=1), "slope": np.polyfit(times - 0.5, values - 1e5, 1)[0]}
    _time, latest = course(until(statistic, low=np.inf), times, values)
    assert latest == pytest.approx(expected[statistic], rel=1e-6, abs=1e-5)


def test_nothing_is_met_before_a_whole_window_after_the_start():
    times = np.arange(500) * 0.01
    time, _ = course(until("mean", low=1.0), times, np.full(500, 2.0), start=0.7)
    assert time == pytest.approx(1.7, abs=0.02)


def test_a_missing_sample_or_a_silent_channel_meets_nothing():
    times = np.arange(300) * 0.01
    values = np.where(np.arange(300) % 50 == 0, np.nan, 2.0)
    assert np.isnan(course(until("mean", low=1.0), times, values)[0])
    judge = Judge(until("std", high=1.0), 0.0)
    assert not any(judge.met(time) for time in times)


CRITERION = "{quantity: velocity, role: test, window_s: 0.1, above: ABOVE, unit: rad/s, otherwise: OTHERWISE}"


def adaptive(above, otherwise="continue"):
    criterion = CRITERION.replace("ABOVE", str(above)).replace("OTHERWISE", otherwise)
    return SPIN.replace("settle_s: 0.1}", f"settle_s: 0.1, until: {criterion}}}")


@pytest.mark.parametrize(("above", "met"), [(-1000.0, "met"), (1.0, "met"), (1000.0, "not met")])
def test_whatever_the_plant_answers_a_hold_stays_within_its_bounds(spin, tmp_path, above, met):
    outcome, _bench = spin(adaptive(above), sets=("seed=3", "hold_s=1.5"))
    assert outcome.status == "complete"
    planned = protocolfile.load(str(tmp_path / "protocol.yaml"), {"hold_s": "1.5"}).duration_s
    with Run.open(outcome.path) as run:
        hold = run.steps[1]
        assert hold.parameters["until"] == met
        assert 0.2 - 1e-9 <= hold.stop - hold.start <= 1.5 + 1e-9
        assert (hold.stop - hold.start < 1.49) == (met == "met")
        assert sum(step.stop - step.start for step in run.steps) <= planned + 1e-9
        assert any(f": {met} after" in event.message for event in run.events)


def test_a_criterion_that_has_to_be_met_ends_the_run(spin):
    outcome, _bench = spin(adaptive(1000.0, "fail"))
    assert (outcome.status, outcome.error.exit_status) == ("failed", 5)
    assert "was expected" in outcome.reason


def test_a_window_of_few_cycles_is_judged_as_it_ends():
    times = np.arange(1, 20) * 0.01
    time, _ = course(until("mean", low=1.0, window=0.03), times, np.full(19, 2.0))
    assert time == pytest.approx(0.03)


def test_a_hold_that_is_cut_short_is_not_told_as_not_met(spin):
    outcome, _bench = spin(adaptive(1000.0), at=[(0.5, lambda _bench: signal.raise_signal(signal.SIGINT))])
    assert outcome.status == "stopped"
    with Run.open(outcome.path) as run:
        assert run.steps[-1].parameters["until"] == "cut short"
