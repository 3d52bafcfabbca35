"""A replay that goes farther astray than a sound machine's is no sound one, and one that goes as far is."""

import dataclasses

import numpy as np
import pytest

from leactl.gap.diagnosis import Shrinkage
from leactl.gap.search.evidence import Evidence
from leactl.gap.verdict.astray import astray
from leactl.gap.verdict.judge import UNREST, strayed
from leactl.gap.verdict.where import REPLAY_MISS
from tests.gap.joints import Log, case, drawn_joint

VELOCITY = ("velocity", "test", "free")


@pytest.fixture(scope="module")
def sound():
    random = np.random.default_rng(3)
    made = case(drawn_joint(random), Log(), random)
    return Evidence(made.fitted, made.model, only=[]), made.held_out


def line(over, floor=0.01):
    return Shrinkage("velocity", "test", "free", "rad/s", 1.0, over * floor, over * floor, floor)


def test_a_channel_as_far_as_a_replay_may_be_costs_no_simulation(sound):
    _, held_out = sound
    assert astray(None, held_out, [line(REPLAY_MISS)]) == {}
    assert astray(None, held_out, [line(5.0, floor=0.0)]) == {}


def test_how_far_is_told_beside_a_sound_machine_s_replay(sound):
    evidence, held_out = sound
    near, far = (astray(evidence, held_out, [line(over)])[VELOCITY] for over in (10.0, 100.0))
    assert far == pytest.approx(10.0 * near)
    assert 1.0 < near <= 10.0  # a sound machine's replay is off by its floor at the least
    for other in ({"quantity": "torque"}, {"mechanical": "locked"}, {"mechanical": "coupled"}):
        assert astray(evidence, held_out, [dataclasses.replace(line(100.0), **other)]) == {}


def test_a_replay_gone_astray_is_told_with_the_set_up_s_most_restless_equation():
    restless = {("free_torque", "velocity", "free"): 1.2, ("current", "q_axis_current", "free"): 2.8}
    told = strayed({VELOCITY: 2.0 * UNREST}, restless)
    assert told.probability > 0.8
    assert told.channel == ("free_torque", "velocity", "free")
    assert "the replay of velocity, free goes 10 times as far astray as a sound model's" in told.note
    assert strayed({VELOCITY: UNREST}, restless).probability == pytest.approx(0.5)
    assert strayed({VELOCITY: 1.0}, restless).probability < 0.02
    assert strayed({("torque", "test", "locked"): 50.0}, restless).channel is None
    assert strayed({}, restless).probability == 0.0
