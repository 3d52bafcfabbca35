"""Effects of one class: replays of held-out runs rule out what is clearly farther, and nothing else."""

import json

import numpy as np
import pytest

from leactl.emulation.blind.make import make
from leactl.gap.diagnose import diagnose, read_case
from leactl.gap.replay import replay
from leactl.gap.search.effect_sets import FurtherEffect
from leactl.gap.verdict.decision import NAMED_PROBABILITY
from leactl.gap.verdict.judge import Judged
from leactl.gap.verdict.separation import RuledOut, nearest_of_classes, without_ruled_out
from leactl.gap.verdict.shrinkage import SquaresRatio, simulate_again, squares_ratio
from tests.gap.synthetic import INTERVAL_S, model, record

LATE = ("torque_sensor_lag", "time_skew")
RANDOM = np.random.default_rng(0)
SEED, CASES = 703, 12  # drawn once, never used to choose a threshold


def finding(effect, gain=1e5):
    return FurtherEffect((effect, ()), gain, 20.0, 1.0, (20.0,), ("size",), np.eye(1), 0.0)


def member(first, *peers):
    rivals = tuple((finding(effect, 0.999e5 - index), 0.3) for index, effect in enumerate(peers))
    return Judged(finding(first), 1.0, 0.99, rivals, peers)


def by_squares(squares, spread=1.02, farthest=2.0):
    """Compare sets by what their effects leave, the ends of the interval a factor off."""

    def compare(first, second):
        value = sum(squares[effect] for effect, _ in second) / sum(squares[effect] for effect, _ in first)
        return SquaresRatio(value, value / spread, value * spread, farthest)

    return compare


def names(hypothesis):
    return [effect for effect, _ in hypothesis]


def test_a_rival_that_is_clearly_farther_is_ruled_out():
    lag = member("torque_sensor_lag", "time_skew")
    nearest, ruled_out = nearest_of_classes([lag.finding.candidate], [lag], by_squares({LATE[0]: 2.0, LATE[1]: 3.0}))
    assert names(nearest) == ["torque_sensor_lag"]
    assert [(ruling.effect, ruling.by, ruling.times) for ruling in ruled_out] == [
        ("time_skew", "torque_sensor_lag", 1.5)
    ]
    left = without_ruled_out(lag, ruled_out)
    assert left.peers == ()
    assert [probability for _, probability in left.rivals] == [0.0]
    assert "time_skew is ruled out beside torque_sensor_lag" in ruled_out[0].note()


def test_a_rival_that_is_clearly_nearer_takes_the_place():
    lag = member("torque_sensor_lag", "time_skew")
    others = [("cogging", ()), lag.finding.candidate]
    nearest, ruled_out = nearest_of_classes(others, [lag], by_squares({"cogging": 0.1, LATE[0]: 3.0, LATE[1]: 2.0}))
    assert names(nearest) == ["cogging", "time_skew"]
    assert [(ruling.effect, ruling.by) for ruling in ruled_out] == [("torque_sensor_lag", "time_skew")]


def test_the_nearest_of_three_is_left():
    lag = member("torque_sensor_lag", "time_skew", "transport_delay")
    squares = {LATE[0]: 3.0, LATE[1]: 2.0, "transport_delay": 1.0}
    nearest, ruled_out = nearest_of_classes([lag.finding.candidate], [lag], by_squares(squares))
    assert names(nearest) == ["transport_delay"]
    assert {ruling.effect for ruling in ruled_out} == set(LATE)


@pytest.mark.parametrize(
    ("times", "spread"), [(1.05, 1.001), (1.3, 1.4), (1 / 1.05, 1.001), (1 / 1.3, 1.4), (1.0, 1.0)]
)
def test_none_is_ruled_out_within_a_replays_own_errors_or_by_chance(times, spread):
    lag = member("torque_sensor_lag", "time_skew")
    compare = by_squares({LATE[0]: 1.0, LATE[1]: times}, spread)
    assert nearest_of_classes([lag.finding.candidate], [lag], compare) == ([lag.finding.candidate], [])


@pytest.mark.parametrize("times", [3.0, 1 / 3.0])
def test_a_replay_that_stands_far_off_rules_nothing_out(times):
    """A free run of a real axis is 80 floors off, with an offset of its current as with a friction by direction."""
    lag = member("torque_sensor_lag", "time_skew")
    for farthest, decided in ((5.9, True), (6.1, False)):
        compare = by_squares({LATE[0]: 1.0, LATE[1]: times}, 1.02, farthest)
        assert bool(nearest_of_classes([lag.finding.candidate], [lag], compare)[1]) is decided


def test_a_replay_does_not_decide_between_two_effects_that_are_one_law_in_every_row():
    """A friction by direction and an offset of the current differ only where the shaft begins to move."""
    first, second = finding("asymmetric_friction"), finding("current_sensor_offset")
    judgement = Judged(first, 1.0, 0.99, ((second, 0.3),), (second.effect,))
    compare = by_squares({first.effect: 1.0, second.effect: 1.7})
    assert nearest_of_classes([first.candidate], [judgement], compare) == ([first.candidate], [])


def test_what_no_run_compares_rules_nothing_out():
    lag = member("torque_sensor_lag", "time_skew")
    nearest = nearest_of_classes([lag.finding.candidate], [lag], lambda first, second: squares_ratio([], RANDOM))
    assert nearest == ([lag.finding.candidate], [])


def square_wave(truth, seconds=12.0):
    """A locked run under steps whose torque is the truth's own output with noise."""
    time = INTERVAL_S * np.arange(round(seconds / INTERVAL_S))
    run = record("locked", reference=8.0 * np.sign(np.sin(2.0 * np.pi * 11.0 * time)), seconds=seconds)
    torque = np.nan_to_num(replay(run, truth).fast["torque", "test"])
    run.fast.values["torque", "test"] = torque + 0.01 * np.random.default_rng(0).standard_normal(len(torque))
    return run


def test_a_torque_that_is_late_is_told_from_one_that_lags_though_other_channels_stand_still():
    late = model(("time_skew", {"delay": 0.003}))
    lagging = model(("torque_sensor_lag", {"time_constant": 0.003}))
    run = [square_wave(late)]
    ratio = squares_ratio(simulate_again(run, (late, late, lagging), RANDOM)[1], RANDOM)
    assert 1.1 < ratio.low < ratio.value < ratio.high < np.inf
    assert ratio.worst_miss == 1.1  # on the torque alone, which the true model follows to its noise
    turned = squares_ratio(simulate_again(run, (lagging, lagging, late), RANDOM)[1], RANDOM)
    assert turned.low < turned.value < turned.high < 1.0 / 1.1


def test_a_run_too_short_to_tell_chance_rules_nothing_out():
    late = model(("time_skew", {"delay": 0.003}))
    lagging = model(("torque_sensor_lag", {"time_constant": 0.003}))
    _, channels = simulate_again([square_wave(late, seconds=2.0)], (late, late, lagging), RANDOM)
    assert np.isnan(squares_ratio(channels, RANDOM).value)


def test_what_is_ruled_out_in_one_class_stays_in_another():
    lag, ripple = member("torque_sensor_lag", "time_skew"), member("cogging", "time_skew")
    ruled_out = [RuledOut("time_skew", "torque_sensor_lag", 1.5)]
    assert without_ruled_out(lag, ruled_out).peers == ()
    assert without_ruled_out(ripple, ruled_out).peers == ("time_skew",)


def test_an_effect_that_two_classes_share_is_put_into_a_set_once():
    lag, ripple = member("torque_sensor_lag", "time_skew"), member("cogging", "time_skew")
    compare = by_squares({"torque_sensor_lag": 3.0, "cogging": 3.0, "time_skew": 1.0})
    nearest, _ = nearest_of_classes([lag.finding.candidate, ripple.finding.candidate], [lag, ripple], compare)
    assert names(nearest) == ["time_skew", "cogging"]


@pytest.mark.long
def test_what_truly_acts_is_never_ruled_out_and_most_classes_are_resolved(tmp_path):
    make(CASES, tmp_path / "cases", tmp_path / "key", SEED, ("single",), LATE, strengths=("faint", "plain"))
    truths = json.loads((tmp_path / "key" / "key.json").read_text(encoding="utf-8"))["cases"]
    alone = 0
    for name, truth in truths.items():
        runs = sorted((tmp_path / "cases" / name).glob("*.h5"))
        fitted, held_out = ([run for run in runs if end in run.name] for end in ("-a", "-b"))
        causes = diagnose(read_case(fitted, held_out, runs[0].parent / "nominal.yaml")).causes
        named = {cause.effect for cause in causes if cause.probability >= NAMED_PROBABILITY}
        assert truth["effects"][0] in named, name
        alone += named == set(truth["effects"])
    print(f"{alone} of {CASES} named alone, the others as one of two")
    assert alone >= 0.75 * CASES
