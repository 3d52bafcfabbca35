"""Replays that tell nothing: behind a long gap in what drives them, and where they ran away."""

from dataclasses import replace

import numpy as np
import pytest

from leactl.gap.replay import replay_all
from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.comparison import compare
from leactl.gap.replay.job import Job
from tests.gap.joints import case, drawn_joint, drawn_log

GAP = slice(1210, 1330)
CURRENT, VELOCITY = ("q_axis_current", "test"), ("velocity", "test")


@pytest.fixture(scope="module")
def joint_case():
    random = np.random.default_rng(4)
    return case(drawn_joint(random), drawn_log(random), random)


def compared(record, model):
    """The velocity of a record beside its replay, and the samples at which the replay starts again."""
    job = Job(record, plant_of(model))
    replay_all([job])
    (channel,) = [channel for channel in compare(record, [job], job) if channel.quantity == "velocity"]
    return channel, job.starts


def test_it_is_compared_again_from_where_it_starts_again(joint_case):
    record, model = joint_case.fitted[0], joint_case.model
    whole, starts = compared(record, model)
    current = record.fast.values[CURRENT].copy()
    current[GAP] = 0.0
    valid = record.fast.valid[CURRENT].copy()
    valid[GAP] = False
    clock = replace(
        record.fast, values=record.fast.values | {CURRENT: current}, valid=record.fast.valid | {CURRENT: valid}
    )
    gapped, _ = compared(replace(record, fast=clock), model)
    restart = starts[starts >= GAP.stop][0]
    assert restart > GAP.stop
    assert list(gapped.index) == [index for index in whole.index if not GAP.start <= index < restart]
    assert np.sqrt(np.mean(gapped.squares(0))) == pytest.approx(np.sqrt(np.mean(whole.squares(0))), rel=0.1)


def test_samples_that_are_held_out_are_no_gap(joint_case):
    record, model = joint_case.fitted[0], joint_case.model
    whole, _ = compared(record, model)
    remaining, held_out = (compared(part, model)[0] for part in record.hold_out_stretches())
    assert sorted([*remaining.index, *held_out.index]) == list(whole.index)


def test_a_replay_that_ran_away_has_no_floor_beyond_the_range_of_its_channel(joint_case):
    channel, _ = compared(joint_case.fitted[0], joint_case.model)
    ran_away = replace(channel, disturbed=1e20 * np.ones(len(channel.measured)))
    assert np.max(ran_away.floor_squares()) == pytest.approx(np.ptp(channel.measured) ** 2, rel=0.01)
