"""A log that is slower than what sets its setpoints makes no machine late; one that keeps up with them shows delays."""

import math
from dataclasses import replace

import numpy as np
import pytest

from leactl.gap.diagnose import diagnose
from leactl.gap.replay import replay
from leactl.gap.signals import setpoints
from leactl.gap.signals.setpoints import (
    LEAST_NEXT_ROW_STDS,
    ReferenceFollowing,
    changes_between,
    follow,
    holds,
    leaps,
    mark_setpoints,
    stds_against_next_row,
    unknown_setpoints,
    weight_of_next_row,
)
from leactl.gap.signals.stamps import TAPS, neighbour
from leactl.joints.make import draw_machines, draw_runs
from tests.gap import joints
from tests.gap.drawn_machines import write_cases
from tests.gap.joints import Effect, Log, case, drawn_joint
from tests.gap.test_similar import thinned
from tests.gap.test_similar_machines import case_of as logged_slower


@pytest.fixture(autouse=True)
def setpoints_at_any_sample(monkeypatch):
    """Steps that begin at any sample of a run, and not at every so manieth one."""
    even = joints.reference

    def uneven(kind, top, time, seconds, random):
        asked = even(kind, top, time, seconds, random)
        if kind in ("multisine", "ramp"):
            return asked
        begins = np.arange(1, 8) * len(time) // 8 + random.integers(-20, 20, 7)
        return asked[np.searchsorted(begins, np.arange(len(time)), side="right") * len(time) // 8 + 20]

    monkeypatch.setattr(joints, "reference", uneven)


def joint_case(seed, effect=joints.SOUND, times_thinned=0):
    random = np.random.default_rng(seed)
    drawn = case(drawn_joint(random), Log(), random, effect)
    for _ in range(times_thinned):
        drawn = thinned(drawn)
    return drawn


def changes_setpoints_between_rows(drawn):
    runs = mark_setpoints([*drawn.fitted, *drawn.held_out], drawn.model)
    results = {record.fast.setpoints_between for record in runs}
    assert len(results) == 1, "all runs are of one log"
    return results.pop()


@pytest.mark.parametrize("seed", [6])
def test_a_thinned_log_shows_that_setpoints_change_between_its_rows(seed):
    shown = [changes_setpoints_between_rows(joint_case(seed, times_thinned=times)) for times in range(3)]
    assert shown == [False, True, True]


@pytest.mark.parametrize("delay", [1, 2])
def test_a_late_drive_is_no_sign_of_setpoints_between_rows(delay):
    assert not changes_setpoints_between_rows(joint_case(6, Effect(delay=delay)))


def limited_joint(seed, rows):
    """A joint whose drive takes so many rows for the highest current."""
    drawn = drawn_joint(np.random.default_rng(seed))
    return joint_case(seed, Effect(slew=drawn.top * drawn.rate / rows))


@pytest.mark.parametrize("seed", [2, 7])
def test_a_drive_of_a_limited_rate_is_no_sign_of_setpoints_between_rows(seed):
    limited = limited_joint(seed, 20)
    runs = [(record, shown) for record in limited.held_out if (shown := follow(record, limited.model)) is not None]
    assert any(changes_between(shown.residuals, shown.leap_sizes) for _, shown in runs), "the limit is missed at leaps"
    assert not changes_setpoints_between_rows(limited)


def test_a_replay_takes_the_current_as_measured_where_a_setpoint_between_rows_may_have_moved_it():
    drawn = joint_case(0, times_thinned=1)
    runs = mark_setpoints([*drawn.fitted, *drawn.held_out], drawn.model)
    leaping = max(runs, key=lambda record: int(unknown_setpoints(record.fast, drawn.model).sum()))
    unknown = unknown_setpoints(leaping.fast, drawn.model)
    job = replay(leaping, drawn.model)
    reading = job.fast["q_axis_current", "test"]
    assert 0.0 < unknown.mean() < 0.9
    assert np.isnan(reading[unknown]).all()
    assert np.isfinite(reading[~unknown][job.first + 1 :]).all()
    ends = slice(job.parts, None, job.parts)
    driving, measured = job.current[ends], leaping.fast.values["q_axis_current", "test"][1:]
    miss = np.abs(driving - measured[: len(driving)])[unknown[1:]]
    held = replay(replace(leaping, fast=replace(leaping.fast, setpoints_between=False)), drawn.model).current[ends]
    assert miss.max() < 0.1 * np.abs(held - measured[: len(held)])[unknown[1:]].max()


@pytest.mark.parametrize("times_thinned", [0, 1, 2])
@pytest.mark.parametrize(
    ("seed", "rows"), [(2, 1), (2, 16), *(pytest.param(*drawn, marks=pytest.mark.long) for drawn in ((7, 1), (3, 16)))]
)
def test_rows_hold_their_setpoint_where_one_swift_rate_meets_every_leap(seed, rows, times_thinned):
    limited = limited_joint(seed, rows)
    for _ in range(times_thinned):
        limited = thinned(limited)
    runs = mark_setpoints([*limited.fitted, *limited.held_out], limited.model)
    assert {record.fast.setpoints_held for record in runs} == {rows == 1 and times_thinned == 0}, (
        "a ramp of many rows meets its leap whenever it begins"
    )


@pytest.mark.long
def test_a_drive_of_a_limited_rate_is_named():
    diagnosis = diagnose(limited_joint(2, 5))
    assert [cause.effect for cause in diagnosis.causes if cause.probability >= 0.5] == ["command_slew_limit"]


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 7])
def test_a_limit_whose_ramps_end_within_their_rows_is_named(seed):
    diagnosis = diagnose(limited_joint(seed, 1))
    assert [cause.effect for cause in diagnosis.causes if cause.probability >= 0.5] == ["command_slew_limit"]


@pytest.mark.parametrize("times", [pytest.param(1, marks=pytest.mark.long), 2])
def test_a_sound_joint_is_not_late_in_a_thinned_log(times):
    diagnosis = diagnose(joint_case(6, times_thinned=times))
    assert diagnosis.verdict == "calibration"
    assert not [cause for cause in diagnosis.causes if cause.probability >= 0.5]
    assert any(note.startswith("setpoints change between the rows") for note in diagnosis.notes)


def test_a_late_drive_is_named_in_a_thinned_log():
    diagnosis = diagnose(joint_case(6, Effect(delay=6), times_thinned=1))
    assert [cause.effect for cause in diagnosis.causes if cause.probability >= 0.5] == ["transport_delay"]


@pytest.mark.parametrize(("lost", "held"), [(0, True), (1, False)])
def test_rows_hold_their_setpoint_only_where_no_leap_is_missed(lost, held):
    missed, leaping = np.zeros(200), np.zeros(200)
    leaping[20::20] = 300.0
    missed[20::20] = 6.0  # above noise, but 2 % of the leap: so much does a filter of another kind
    missed[20 : 20 + 20 * lost : 20] = 60.0
    assert holds(missed, leaping, leaping > 0.0) == held
    assert not holds(missed, leaping, np.zeros(200, np.bool_)), "ramps that bend slowly tell nothing"


def test_a_log_of_which_one_run_misses_a_leap_holds_no_setpoint(monkeypatch):
    leaping = np.where(np.arange(200) % 50 == 20, 300.0, 0.0)
    missed = np.where(np.arange(200) == 20, 60.0, 0.0)
    records = joint_case(6).fitted[:2]
    shown = {
        record.name: ReferenceFollowing(one, leaping, leaping > 0.0, (0.0, math.inf), 1.0)
        for record, one in zip(records, (0.0 * missed, missed), strict=True)
    }
    monkeypatch.setattr(setpoints, "follow", lambda record, *at_a_rate: shown[record.name])
    assert [record.fast.setpoints_held for record in mark_setpoints(records, None)] == [False, False]


@pytest.mark.parametrize("between", [False, True])
def test_only_a_curve_between_rows_goes_against_the_row_that_follows(between):
    random = np.random.default_rng(5)
    asked = np.convolve(random.standard_normal(16_000), np.hanning(24) / 6.0, "same").repeat(1 if between else 4)[
        :16_000
    ]
    means = asked.reshape(-1, 4).mean(axis=1)
    rows = asked[3::4]
    taps = np.column_stack([np.ones_like(rows), rows, *(neighbour(rows, by) for by in TAPS.tolist())])[4:-4]
    current = means[4:-4] + 0.005 * random.standard_normal(len(taps))
    shares = [weight_of_next_row(taps[part], current[part]) for part in np.array_split(np.arange(len(taps)), 3)]
    assert (stds_against_next_row(shares) > LEAST_NEXT_ROW_STDS) is between
    assert stds_against_next_row([(0.0, math.inf)]) == 0.0, "rows that tell nothing"


def test_a_wave_that_its_rows_show_does_not_leap():
    rows = np.arange(200)
    assert not leaps(np.sin(2.0 * np.pi * rows / 11.0)).any()
    assert np.flatnonzero(leaps((rows > 99).astype(float))).tolist() == [99, 100]


@pytest.mark.parametrize(
    ("third", "seed"), [pytest.param(*drawn, marks=pytest.mark.long) for drawn in (("steps", 11), ("multisine", 2))]
)
def test_a_sound_servo_is_not_late_in_a_log_of_every_fourth_sample(tmp_path, third, seed):
    spindle = draw_machines(np.random.default_rng([77, 0]), 10)[1]
    assert "velocity_reference" in spindle.channels
    machine = replace(spindle, protocols=("levels", "ramp", third))
    write_cases(tmp_path, {"servo": (machine, draw_runs(np.random.default_rng([77, 1, seed]), machine, [], "plain"))})
    diagnosis = diagnose(logged_slower(tmp_path / "servo", divide=4))
    assert diagnosis.verdict == "calibration"
    assert not [cause for cause in diagnosis.causes if cause.probability >= 0.5]
