"""The envelope of a machine whose voltage equation is solved by itself."""

import math
import re

import numpy as np
import pytest

from leactl.analysis.experiments.torque_speed_envelope import analyze
from leactl.errors import MissingChannel, NotIdentifiable

from .envelopes import ASKED, KT, SPEEDS, B, F, current_at, driven, true_corner
from .synthetic import analyzed, covered


def test_highest_torque_power_and_corner_come_back(bench):
    result = analyzed(analyze, driven(bench, scatter=0.005))
    assert result.find("highest_torque").value == pytest.approx(KT * ASKED - F - 5 * B, abs=0.02)
    assert result.find("speed_of_highest_torque").value == pytest.approx(5.0, abs=0.01)
    powers = {speed: speed * (KT * current_at(speed) - F - B * speed) for speed in SPEEDS}
    fastest = max(powers, key=powers.get)
    assert result.find("highest_power").value == pytest.approx(powers[fastest], rel=0.002)
    assert result.find("speed_of_highest_power").value == pytest.approx(fastest, abs=0.01)
    assert result.find("corner_speed").value == pytest.approx(true_corner(), rel=0.01)
    assert result.find("current_limit").value == ASKED


@pytest.mark.long
def test_intervals_hold_the_truth_in_95_of_100_times(bench):
    held = 0
    for _ in range(20):
        result = analyzed(analyze, driven(bench, scatter=0.05, trials=2)).find("highest_torque")
        held += covered(result, KT * ASKED - F - 5 * B)
    assert held >= 16  # three standard deviations below 19 of 20


@pytest.mark.parametrize(
    ("speeds", "ends", "words"),
    [
        ((5.0, 10.0, 20.0), (20.0, math.inf), "the corner lies above"),
        ((30.0, 33.0), (0.0, 30.0), "the corner lies below"),
        ((20.0, 34.0), (20.0, 34.0), "3 holds beyond the corner"),
    ],
)
def test_a_corner_that_was_not_driven_through_has_bounds_and_no_value(bench, speeds, ends, words):
    result = analyzed(analyze, driven(bench, speeds=speeds))
    outcome = result.find("corner_speed")
    assert math.isnan(outcome.value)
    assert (outcome.low, outcome.high) == pytest.approx(ends, abs=0.02)
    assert any(words in note for note in result.notes)


def test_a_supply_that_sags_and_levels_that_brake_are_named(bench):
    def brake(_time, columns):
        columns["torque"][columns["velocity"] < 7] *= -1

    result = analyzed(analyze, driven(bench, sag=0.1, edit=brake))
    assert any("the supply sagged from" in note for note in result.notes)
    assert any("left out 3: the actuator gave no power" in note for note in result.notes)
    assert result.find("speed_of_highest_torque").value == pytest.approx(10.0, abs=0.01)


def test_a_speed_that_drifts_within_a_hold_is_named(bench):
    def drift(time, columns):
        columns["velocity"] += 0.2 * (time % 2.5)

    silent = analyzed(analyze, driven(bench, edit=drift, model="name: x\n"))
    assert any("the rotor's inertia is in its torque, and in no interval" in note for note in silent.notes)
    assert not any("inertia" in note for note in analyzed(analyze, driven(bench)).notes)


def test_what_the_inertia_gives_while_the_speed_falls_is_no_torque_of_the_current(bench):
    """2.4 g m^2 at 10 rad/s^2 are 24 mN m."""
    result = analyzed(analyze, driven(bench, slowing=10.0, speeds=(20.0, 24.0), before_s=2.0, noise=1e-4))
    assert result.find("highest_torque").value == pytest.approx(KT * ASKED - F - 20 * B, abs=0.001)
    assert any("the rotor's inertia is put back" in note for note in result.notes)
    assert covered(result.find("highest_torque"), KT * ASKED - F - 20 * B)


def test_the_error_of_the_sensor_s_zero_is_in_the_interval(bench):
    told, silent = (analyzed(analyze, driven(bench, before_s=before, noise={"torque": 0.1})) for before in (2.0, 0.0))
    assert any("the uncertainty of its zero is not known" in note for note in silent.notes)
    assert told.find("highest_torque").std > 0.02 > silent.find("highest_torque").std


def test_repeats_that_find_the_winding_warmer_are_no_scatter_of_the_corner(bench):
    result = analyzed(analyze, driven(bench, warmed=[(0.0, 0.0), (10.0, 0.0), (20.0, 0.0)])).find("corner_speed")
    assert result.value == pytest.approx(np.mean([true_corner(kelvin) for kelvin in (0, 10, 20)]), abs=0.01)
    assert result.high - result.low < 0.1


@pytest.mark.parametrize("trials", [2, 3])
def test_a_corner_that_drifts_with_the_winding_s_warmth_is_named_with_its_size(bench, trials):
    warmed = [(8.0 * trial, 4.0) for trial in range(trials)]
    result = analyzed(analyze, driven(bench, trials=trials, scatter=0.002, warmed=warmed))
    [note] = [note for note in result.notes if note.startswith("the corner drifts")]
    moved = true_corner(8.0 * (trials - 1) + 4.0) - true_corner(4.0)
    assert float(re.search(r"by (\S+) rad/s from the first repeat to the last", note)[1]) == pytest.approx(
        moved, rel=0.1
    )
    assert "corner_speed is that of their mean" in note


def test_a_corner_that_stays_is_not_said_to_drift(bench):
    for _ in range(20):
        result = analyzed(analyze, driven(bench, scatter=0.01, trials=2, noise=0.01))
        assert not any("drifts" in note for note in result.notes)


def test_without_repeats_no_interval_is_given(bench):
    result = analyzed(analyze, driven(bench, trials=1))
    assert math.isnan(result.find("highest_torque").std)
    assert any("highest_torque without a repeat" in note for note in result.notes)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda _time, columns: columns["torque"].__imul__(-1), "found no hold in which the actuator drove"),
        (None, "one current was expected"),
    ],
)
def test_a_run_that_cannot_answer_says_why_in_one_line(bench, edit, words):
    paths = [driven(bench, edit=edit), *([] if edit else [driven(bench, asked=20.0)])]
    with pytest.raises(NotIdentifiable, match=words) as caught:
        analyzed(analyze, *paths)
    assert len(caught.value.faults) == 1


def test_a_run_without_torque_is_refused(bench):
    with pytest.raises(MissingChannel, match="no torque of test"):
        analyzed(analyze, bench.friction())
