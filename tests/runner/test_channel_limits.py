"""Limits on channels of a protocol without an analysis: known in the run, judged at its end, told in its file."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.errors import AcceptanceFailed, InputError
from leactl.protocol.plan import ChannelBounds
from leactl.quantities import ChannelSpec
from leactl.runfile.read.reader import Run
from leactl.runner.acceptance import judge_run_file
from leactl.runner.channel_limits import ChannelLimits
from tests.runner.conftest import SPIN

STREAMS = {"loop": [ChannelSpec("test_iq", "q_axis_current", "test", "drive")]}


def limited(*limits):
    return SPIN + "acceptance:\n" + "".join(f"  - {{channel: {limit}}}\n" for limit in limits)


def test_limits_that_are_kept_and_not_are_told_in_rows_lines_and_events(spin):
    text = limited(
        "q_axis_current, step: hold, statistic: mean, low: 500, high: 1100, unit: mA",
        "q_axis_current, step: hold, statistic: max, high: 0.2, unit: A",
        "velocity, statistic: min, low: -100, unit: rpm",
    )
    outcome, _bench = spin(text)
    assert outcome.status == "complete"
    assert [verdict.met for verdict in outcome.verdicts] == [True, False, True]
    row = outcome.verdicts[1].row
    assert (row["channel"], row["statistic"], row["step"], row["units"]) == ("q_axis_current", "max", "hold", "A")
    assert 0.7 < row["value"] < 1.5
    with Run.open(outcome.path) as run:
        events = [(event.level, event.source, event.message) for event in run.events]
    told = [verdict.summary for verdict in outcome.verdicts]
    assert [event for event in events if event[1] == "acceptance"] == [
        ("info", "acceptance", told[0]),
        ("warning", "acceptance", told[1]),
        ("info", "acceptance", told[2]),
    ]
    broken = [event for event in events if event[1] == "runner" and event[2].startswith("acceptance: max of test")]
    assert len(broken) == 1  # as soon as it is known, once
    from leactl.protocol import protocolfile

    plan = protocolfile.load(str(outcome.path.parent.parent / "protocol.yaml"))
    assert judge_run_file(plan, outcome.path) == ([], [f"acceptance: {told[1]}"])


def test_a_limit_may_stop_the_run_at_once(spin):
    outcome, _bench = spin(limited("q_axis_current, step: hold, statistic: max, high: 0.2, unit: A, stop: true"))
    assert isinstance(outcome.error, AcceptanceFailed)
    assert outcome.error.exit_status == 6
    assert outcome.status == "failed"
    assert outcome.duration_s < 0.3
    assert all(confirmation.safe for confirmation in outcome.safe.values())
    assert not outcome.verdicts[0].met


def test_a_channel_that_the_bench_does_not_measure_is_refused_before_the_run(spin):
    with pytest.raises(InputError, match="measures no phase_voltage_ab of role 'load' to judge"):
        spin(limited("phase_voltage_ab, role: load, statistic: max, high: 1, unit: V"))


def judged(statistic, windows, low=-math.inf, high=math.inf, unit="A"):
    limit = ChannelBounds("q_axis_current", "test", "hold", statistic, low, high, unit)
    limits = ChannelLimits([limit], STREAMS, "trial")
    notes = []
    for number, values in enumerate(windows):
        limits.enter("hold", float(number))
        for place, value in enumerate(values):
            limits.receive("loop", number + place / (len(values) + 1), [value], lambda *told: notes.append(told))
        limits.leave("hold", number + 1.0)
    (verdict,) = limits.verdicts()
    return verdict, notes


@given(st.lists(st.floats(-100, 100), min_size=2, max_size=30), st.sampled_from(["mean", "min", "max", "std"]))
def test_each_statistic_is_that_of_the_readings(values, statistic):
    expected = {"mean": np.mean, "min": np.min, "max": np.max, "std": lambda found: np.std(found, ddof=1)}[statistic]
    verdict, _notes = judged(statistic, [values], low=-1e9)
    assert verdict.row["value"] == pytest.approx(expected(values), rel=1e-9, abs=1e-9)
    in_milli, _notes = judged(statistic, [values], low=-1e9, unit="mA")
    assert in_milli.row["value"] == pytest.approx(1e3 * verdict.row["value"], rel=1e-9, abs=1e-6)


def test_every_step_of_the_name_must_keep_the_limit_and_the_worst_is_told():
    verdict, notes = judged("max", [[1.0], [5.0], [2.0]], high=3.0)
    assert not verdict.met
    assert verdict.row["value"] == 5.0
    assert notes == [("warning", "acceptance: max of test q_axis_current in step hold is 5 A, at most 3 was required")]


def test_a_step_in_which_nothing_was_read_does_not_keep_it():
    verdict, _notes = judged("mean", [[1.0], [math.nan]], high=3.0)
    assert not verdict.met
    assert "nothing was read in 1 of 2 steps" in verdict.summary


def test_readings_outside_of_the_judged_part_do_not_count():
    limit = ChannelBounds("q_axis_current", "test", "hold", "max", -math.inf, 3.0, "A")
    limits = ChannelLimits([limit], STREAMS, "trial")
    limits.enter("hold", 1.0)
    limits.leave("hold", 2.0)
    for time, value in ((0.9, 9.0), (1.5, 2.0), (2.0, 9.0)):  # the middle one comes late, and counts
        limits.receive("loop", time, [value], lambda *_told: None)
    assert limits.verdicts()[0].row["value"] == 2.0


def test_a_reading_that_comes_after_its_step_is_one_of_that_step():
    limit = ChannelBounds("q_axis_current", "test", "hold", "max", -math.inf, 5.0, "A")
    limits = ChannelLimits([limit], STREAMS, "trial")
    limits.enter("hold", 0.0)
    limits.leave("hold", 1.0)
    limits.enter("hold", 2.0)
    for time, value in ((2.1, 1.0), (0.9, 4.0), (1.5, 9.0), (2.2, math.inf)):  # neither between two nor endless
        limits.receive("loop", time, [value], lambda *told: None)
    (verdict,) = limits.verdicts()
    assert (verdict.met, verdict.row["value"]) == (True, 4.0)
