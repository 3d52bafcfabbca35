"""Breakaway, drag and cogging from runs in which they are known."""

import math

import numpy as np
import pytest

from leactl.analysis.experiments.back_drive import analyze
from leactl.errors import NotIdentifiable

from .back_driven import COG, ORDER, B, C, F, J, W, driven
from .synthetic import analyzed, covered


def test_every_part_comes_back_and_the_sensor_s_zero_in_none(bench):
    result = analyzed(analyze, driven(bench, trials=3))
    assert result.find("breakaway_torque").value == pytest.approx(0.25, rel=0.02)
    assert result.find("coulomb_friction").value == pytest.approx(F, rel=0.01)
    assert result.find("viscous_damping").value == pytest.approx(B, rel=0.01)
    assert result.find("quadratic_drag").value == pytest.approx(C, rel=0.05)
    assert result.find("breakaway_torque").std < 0.002
    assert result.find("cogging_order").value == ORDER
    assert result.find("cogging_amplitude").value == pytest.approx(COG, rel=0.02)
    assert covered(result.find("cogging_amplitude"), COG)
    assert result.find("cogging_peak_to_peak").value == pytest.approx(2 * COG, rel=0.03)


def test_what_the_rotor_takes_of_the_cogging_is_not_put_back_without_its_inertia(bench):
    result = analyzed(analyze, driven(bench, inertia=0.0))
    assert any("no rotor_inertia in its model" in note for note in result.notes)
    taken = J * 0.05 * ORDER * W
    assert result.find("cogging_amplitude").value == pytest.approx(COG - taken, rel=0.03)


def test_a_rotor_without_cogging_gets_a_bound_and_no_number(bench):
    result = analyzed(analyze, driven(bench, cogging=0.0, ripple=0.0))
    outcome = result.find("cogging_amplitude")
    assert math.isnan(outcome.value)
    assert 0.0 < outcome.high < 0.002
    assert any("cogging is below" in note for note in result.notes)


@pytest.mark.long
def test_intervals_hold_the_truth_in_95_of_100_times(bench):
    true = {"breakaway_torque": 0.25, "coulomb_friction": F, "viscous_damping": B, "cogging_amplitude": COG}
    held = dict.fromkeys(true, 0)
    for _ in range(16):
        result = analyzed(analyze, driven(bench, noise=0.02))
        for name, value in true.items():
            held[name] += covered(result.find(name), value)
    assert min(held.values()) >= 12, held  # three and a half standard deviations below 15 of 16


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"enabled": 1.0}, "the test drive was on at .* back-drive is unpowered"),
        ({"speeds": (2.0, 5.0)}, "found 2 speeds at which the shaft turned steadily; 4 or more are needed"),
    ],
)
def test_a_run_that_cannot_answer_says_why_in_one_line(bench, how, words):
    with pytest.raises(NotIdentifiable, match=words) as caught:
        analyzed(analyze, driven(bench, **how))
    assert len(caught.value.faults) == 1


def test_what_is_missing_of_turns_and_breakaways_is_said_and_the_drag_is_there(bench):
    result = analyzed(analyze, driven(bench, turn_s=6.0, lets_go=False))
    notes = "\n".join(result.notes)
    assert "are no whole turn; it shows no cogging" in notes
    assert "left out 4: the shaft did not let go: give a higher current" in notes
    assert covered(result.find("coulomb_friction"), F)
    assert {"cogging_amplitude", "breakaway_torque"}.isdisjoint(item.name for item in result.results)


def test_one_direction_has_the_sensor_s_zero_in_it_and_says_so(bench):
    result = analyzed(analyze, driven(bench, signs=(1,)))
    assert result.find("coulomb_friction").value == pytest.approx(F - 0.02, abs=0.002)
    assert any("the zero of the torque sensor is part of coulomb_friction" in note for note in result.notes)
    assert any("show no cogging: one in each and a repeat are needed" in note for note in result.notes)


def test_a_clipped_sensor_is_named(bench):
    def clip(columns):
        columns["torque"] = np.clip(columns["torque"], -0.7, 0.7)

    result = analyzed(analyze, driven(bench, edit=clip, speeds=(2.0, 5.0, 8.0, 12.0, 30.0)))
    assert any("torque of test is saturated at" in note for note in result.notes)
    assert covered(result.find("viscous_damping"), B)


def test_a_turn_without_a_reading_of_its_angle_shows_no_cogging(bench):
    def lose(columns):
        columns["angle"] = np.full_like(columns["angle"], np.nan)

    result = analyzed(analyze, driven(bench, edit=lose))
    assert any("no reading of its angle, or of its velocity: it shows no cogging" in note for note in result.notes)
    assert covered(result.find("coulomb_friction"), F)
    assert "cogging_amplitude" not in [item.name for item in result.results]
