"""Saturation from pulses in which it is known, and what cannot be told of it."""

import math

import numpy as np
import pytest

from leactl.analysis.experiments.torque_pulses import analyze
from leactl.errors import InputError, MissingChannel, NotIdentifiable

from .pulses import KT, pulsed
from .synthetic import analyzed, covered


@pytest.mark.parametrize("loss", [0.0, 0.03, 0.1, 0.2])
def test_the_loss_of_a_knee_comes_back(bench, loss):
    result = analyzed(analyze, pulsed(bench, loss=loss))
    assert result.find("loss_at_peak").value == pytest.approx(loss, abs=0.0005 + 0.025 * loss)
    assert result.find("torque_constant").value == pytest.approx(KT, rel=0.007)
    assert result.find("torque_at_peak").value == pytest.approx(KT * 28 * (1 - loss), rel=0.001)
    assert result.find("sticking_torque").value == pytest.approx(0.1, rel=0.01)
    assert result.find("peak_current").value == 28


def test_the_straight_part_ends_where_two_percent_are_missing(bench):
    result = analyzed(analyze, pulsed(bench, scatter=0.005)).find("straight_up_to")
    true = 28 * math.sqrt((0.98**-2 - 1) / (0.9**-2 - 1))
    assert covered(result, true)
    assert result.high - result.low < 3

    straight = analyzed(analyze, pulsed(bench, loss=0.005, scatter=0.005))
    result = straight.find("straight_up_to")
    assert math.isnan(result.value)
    assert result.low > 15
    assert math.isinf(result.high)
    assert any("the bend lies above" in note for note in straight.notes)


@pytest.mark.long
def test_intervals_hold_the_truth_in_95_of_100_times(bench):
    true = {"loss_at_peak": 0.06, "torque_constant": KT, "torque_at_peak": KT * 28 * 0.94}
    held = dict.fromkeys(true, 0)
    for _ in range(40):
        result = analyzed(analyze, pulsed(bench, loss=0.06, scatter=0.02, rate_Hz=4))
        for name, value in true.items():
            held[name] += covered(result.find(name), value)
    assert min(held.values()) >= 33, held  # three and a half standard deviations below 38 of 40


def test_a_gain_error_of_the_sensor_is_in_no_loss(bench):
    def misread(_time, columns):
        columns["torque"] *= 1.1

    result = analyzed(analyze, pulsed(bench, edit=misread))
    assert result.find("loss_at_peak").value == pytest.approx(0.1, abs=0.003)
    assert result.find("torque_constant").value == pytest.approx(1.1 * KT, rel=0.003)


def test_what_is_missing_of_sides_and_signs_is_said(bench):
    result = analyzed(analyze, pulsed(bench, signs=(1,), sides=("",)))
    assert result.find("loss_at_peak").value == pytest.approx(0.1, abs=0.005)
    assert any("pulses of one sign only" in note for note in result.notes)
    assert any("sticking friction is not separated" in note for note in result.notes)
    with pytest.raises(InputError, match="sticking_torque"):
        result.find("sticking_torque")


def test_levels_at_the_sensor_s_end_do_not_count(bench):
    def clip(_time, columns):
        columns["torque"][:] = np.clip(columns["torque"], -10.0, 10.0)

    result = analyzed(analyze, pulsed(bench, loss=0.0, noise=0.01, edit=clip, trials=3))
    assert result.find("peak_current").value == 20
    assert any("torque of test is saturated at" in note for note in result.notes)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"levels": (10.0, 20.0, 28.0)}, "found 3 magnitudes of current; 5 or more are needed"),
        ({"levels": (10.0,), "signs": (1,)}, r"found one level \(10 A in 4 holds"),
        ({"key": "velocity_rad_s"}, "no step named 'hold' with current_A"),
    ],
)
def test_a_run_that_cannot_answer_says_why_in_one_line(bench, how, words):
    with pytest.raises(NotIdentifiable, match=words) as caught:
        analyzed(analyze, pulsed(bench, **how))
    assert len(caught.value.faults) == 1


def test_a_run_without_torque_is_refused(bench):
    with pytest.raises(MissingChannel, match="no torque of test"):
        analyzed(analyze, bench.friction())
