"""What is said of a set that was found: rivals by their evidence, lines and unrest by their height, notes once."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from leactl.gap.diagnosis import Near
from leactl.gap.search.effect_sets import TIE_SHARE, FurtherEffect
from leactl.gap.search.ringing import Line
from leactl.gap.signals.record import Record
from leactl.gap.verdict.judge import (
    EVEN_HEIGHT,
    EVEN_LINE_HEIGHT,
    EVEN_RUN_UNREST,
    EVEN_UNREST,
    Judged,
    judge,
    unexplained_in_a_run,
    unexplained_in_channels,
)
from leactl.gap.verdict.notes import condition_notes, reading_notes
from leactl.gap.verdict.state_regression import Sample, learn, slow_gain
from leactl.gap.verdict.unknown import is_slow, nearest_effects, reason_kept_out, shape_picture, squares_beyond_noise

CHANNEL = ("torque balance", "velocity", "free")
OTHER = ("voltage", "q_axis_voltage", "free")


def finding(effect, height, gain=1e5):
    return FurtherEffect((effect, ()), gain, height, 1.0, (height,), ("size",), np.eye(1), 0.0)


def of_one(member, *rivals, missed=None):
    """A set of one member, all of whose gap is explained, beside its rivals."""
    rivals_too = [[member, *rivals]]
    return SimpleNamespace(
        members=[member], rivals=rivals_too, explained=lambda evidence, index: 1.0, squares_missed=missed or {}
    )


def test_a_rival_counts_by_its_gain_and_by_how_high_it_stands_itself():
    member = finding("cogging", 20.0)
    [alike] = judge(None, of_one(member, finding("torque_ripple", 20.0)), {})
    assert alike.peers == ("torque_ripple",)
    assert [round(probability, 2) for _, probability in alike.rivals] == [0.5]
    [low] = judge(None, of_one(member, finding("torque_ripple", EVEN_HEIGHT - 2.0)), {})
    assert low.peers == ()
    assert low.rivals[0][1] < 0.01
    [short] = judge(None, of_one(member, finding("torque_ripple", 20.0, gain=0.9e5)), {})
    assert short.peers == ()


def test_gains_are_no_farther_apart_by_what_forms_miss_than_free_forms_show():
    member, rival = finding("position_spring", 20.0), finding("asymmetric_friction", 20.0, gain=1e5 - 300.0)
    [usual] = judge(None, of_one(member, rival, missed={member.candidate: 1e4}), {})
    assert usual.peers == ("asymmetric_friction",)
    [inexact] = judge(None, of_one(member, rival, missed={rival.candidate: 1e4}), {})
    assert inexact.peers == ("asymmetric_friction",)
    [exact] = judge(None, of_one(member, rival, missed={member.candidate: 12.0, rival.candidate: 3.0}), {})
    assert exact.peers == ()


def test_two_effects_with_the_same_columns_are_one_class_however_much_they_explain():
    member = finding("unbalance", 20.0, gain=1e8)
    [alike] = judge(None, of_one(member, finding("gravity_load", 20.0, gain=1e8 * (1.0 - TIE_SHARE))), {})
    assert alike.peers == ("gravity_load",)


def test_an_effect_that_makes_held_out_runs_worse_is_doubted():
    member = finding("cogging", 20.0)
    [better], [worse] = (judge(None, of_one(member), {member.candidate: gain}) for gain in (5.0, -5.0))
    assert better.probability > 0.9 > 0.5 > worse.probability


@pytest.mark.parametrize("height", [0.5, 0.9, 1.0, 1.2, 3.0])
def test_a_line_and_an_unrest_are_as_likely_as_not_at_their_thresholds_and_the_higher_one_is_told(height):
    line = unexplained_in_channels({}, {CHANNEL: Line(EVEN_LINE_HEIGHT * height, 17.25)})
    rest = unexplained_in_channels({CHANNEL: EVEN_UNREST * height}, {})
    for item in (line, rest):
        assert (item.probability > 0.5) is (height > 1.0)
        assert (item.probability < 0.5) is (height < 1.0)
        assert item.channel == CHANNEL
    assert "rings at about 17.2 Hz" in line.note
    both = unexplained_in_channels(
        {CHANNEL: 2.0 * EVEN_UNREST, OTHER: 3.0 * EVEN_UNREST}, {CHANNEL: Line(EVEN_LINE_HEIGHT / 2.0, 3.0)}
    )
    assert both.channel == OTHER
    assert unexplained_in_channels({CHANNEL: 0.0}, {CHANNEL: Line(0.0, 3.0)}).probability == 0.0
    assert unexplained_in_channels({}, {}).note == ""


@pytest.mark.parametrize("height", [0.5, 0.9, 1.1, 3.0])
def test_a_run_that_stands_out_of_its_channel_is_as_likely_as_not_at_its_threshold(height):
    one = unexplained_in_a_run(
        {
            OTHER: [("a", 1.0)],
            CHANNEL: [("a", 1.0), ("b", EVEN_RUN_UNREST * height), ("c", 1.2), ("c", 9.0), ("c", 0.9)],
        }
    )
    assert (one.probability > 0.5) is (height > 1.0)
    assert one.channel == CHANNEL
    assert f"of b ({CHANNEL[0]}) is {EVEN_RUN_UNREST * height:.3g} times" in one.note
    assert "the middle one of 3 runs 1.2 times; are they of one machine" in one.note


def test_a_run_does_not_stand_out_of_others_that_are_restless_too_nor_by_one_of_its_stretches():
    restless = [("a", 2.0 * EVEN_UNREST), ("b", 1e4), ("c", 1.5 * EVEN_UNREST)]
    in_stretches = [("a", 1.0), ("a", 1e4), ("a", 1.0), ("b", 1.0), ("c", 1.0)]
    assert unexplained_in_a_run({CHANNEL: restless, OTHER: in_stretches}).probability < 0.1


def record(name, notes=(), kind="ramp", condition="", mechanical="free"):
    made = Record(Path(f"{name}.h5"), kind, mechanical, None, None, {})
    return dataclasses.replace(made, notes=tuple(notes), condition=condition)


def test_what_several_runs_have_noted_alike_is_told_once():
    parts = [record("a", ["a: gaps"]), record("a", ["a: gaps"]), record("b", ["b: gaps", "b: late"])]
    assert reading_notes(parts) == ("a and 1 more: gaps", "b: late")
    assert reading_notes(parts[:2]) == ("a: gaps",)


def test_held_out_runs_of_another_condition_are_noted():
    told = condition_notes([record("a"), record("b", condition="cold")], [record("c", condition="hot")])
    assert told == ("ramp: condition of fitted runs: cold, not named; of held-out runs: hot",)
    assert condition_notes([record("a", condition="hot"), record("b")], [record("c", condition="hot")]) == ()
    assert condition_notes([record("a", kind="steps")], [record("c", condition="hot")]) == ()


def stretched(left, stretches=24, runs=1, state=None):
    run = np.repeat(np.arange(runs), len(left) // runs)
    inside = np.tile(np.arange(len(left) // runs) * stretches // (len(left) // runs), runs)
    return Sample(left, state or {}, run * (stretches + 1) + inside)


def test_stretches_of_two_runs_are_no_neighbours():
    sample = stretched(np.repeat([1.0, 1.0], 2400), runs=2)
    gained = slow_gain(sample.residual, sample.stretch)
    inner = np.isin(sample.stretch % 25, range(1, 23))
    assert gained[inner] == pytest.approx(1.0)
    assert not gained[~inner].any()


def test_a_slow_rest_is_one_of_time_and_noise_or_no_gap_is_none():
    time, noise = np.linspace(0.0, 6.0, 4800), np.random.default_rng(3).normal(0.0, 1.0, 4800)
    slow = stretched(np.sin(time) + 0.1 * noise)
    assert is_slow(slow.residual, slow, float(np.sum(slow.residual**2)))
    assert not is_slow(slow.residual, slow, 0.0)
    assert not is_slow(slow.residual, slow, 1e3 * float(np.sum(slow.residual**2)))
    assert not is_slow(noise, stretched(noise), float(np.sum(noise**2)))


def test_squares_beyond_the_noise_of_a_row_are_the_gap():
    rows = SimpleNamespace(left_over=np.zeros(100), white_noise=0.5)
    stack = SimpleNamespace(rows=[rows, None, rows])
    assert squares_beyond_noise(stack, [0, 2], stretched(np.full(240, 1.0))) == pytest.approx(240.0 - 50.0)
    assert squares_beyond_noise(stack, [0, 2], stretched(np.full(240, 0.01))) == 0.0


def test_the_shape_of_a_rest_is_what_it_was_and_what_the_function_leaves_of_it():
    random = np.random.default_rng(4)
    angle = random.uniform(0.0, 2.0 * np.pi, 6000)
    sample = stretched(
        np.cos(31.0 * angle) + random.normal(0.0, 0.05, 6000), state={"angle": angle, "velocity": random.random(6000)}
    )
    trial, chosen, ridge = learn(sample, (1.0, 2.0, 31.0), float(np.sum(sample.residual**2)))
    free = trial.function(chosen, ridge)
    rows = SimpleNamespace(
        quantity="velocity", role="test", mechanical="free", equation="free_torque", units="N*m", dependence=2.0
    )
    told = shape_picture(rows, sample, free, "angle")
    assert told.periods == 31.0
    assert told.before_rms == pytest.approx(np.sqrt(0.5), rel=0.1)
    assert told.after_rms < 0.05 * told.before_rms
    assert shape_picture(rows, sample, free, "velocity").periods is None


def test_a_larger_ridge_makes_a_smaller_function():
    random = np.random.default_rng(5)
    velocity = random.uniform(-1.0, 1.0, 3000)
    sample = stretched(velocity**3 + random.normal(0.0, 0.1, 3000), state={"velocity": velocity})
    trial, chosen, _ = learn(sample, (1.0,), float(np.sum(sample.residual**2)))
    sizes = [float(np.sum(trial.function(chosen, ridge).of(sample) ** 2)) for ridge in (1e-6, 1e-2, 1.0, 100.0)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] < 0.1 * sizes[0]


def test_the_nearest_effects_are_those_refused_then_doubted_then_not_entered_each_once_with_why():
    doubted = Judged(finding("cogging", 2.0), 1.0, 0.1, (), ())
    named = Judged(finding("stribeck", 20.0), 1.0, 0.99, (), ())
    rest = [finding("presliding", 1.5), finding("backlash", 2.5), finding("cogging", 9.0), finding("bus_sag", 0.5)]
    told = nearest_effects(SimpleNamespace(further_effects=rest), [named, doubted], [Near("torque_ripple", "it grew")])
    assert [item.effect for item in told] == ["torque_ripple", "cogging", "backlash", "presliding"]
    assert told[0].refused_because == "it grew"
    assert told[1].refused_because.startswith("its size is 2 times")
    assert told[2].refused_because == reason_kept_out(rest[1])
    few = Judged(finding("cogging", 20.0), 0.3, 0.1, (), ())
    [only] = nearest_effects(SimpleNamespace(further_effects=[]), [few], [])
    assert only.refused_because.startswith("the set explains 30 % of the gap where it acts")
