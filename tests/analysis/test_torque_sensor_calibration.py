"""Calibration by weights of sensors whose errors are known, and the parts of the budget one by one."""

import math

import numpy as np
import pytest

from leactl.analysis.experiments.torque_sensor_calibration import analyze
from leactl.errors import InputError, NotIdentifiable

from .synthetic import analyzed, covered
from .weights import GRAVITY, KNOWN_STDS, weighed

KNOWN = {"gravity": GRAVITY, **KNOWN_STDS}


@pytest.mark.parametrize("gain", [1.0, 1.02, 0.37])
def test_the_factor_and_the_zero_come_back_by_the_gravity_of_the_place(bench, gain):
    result = analyzed(analyze, weighed(bench, gain=gain, scatter=1e-4), **KNOWN)
    assert result.find("sensitivity").value == pytest.approx(gain, rel=1e-4)
    assert result.find("zero").value == pytest.approx(0.02, abs=2e-4)
    assert any("multiply scale_per_V by" in note for note in result.notes) == (gain != 1.0)


def test_what_is_not_given_of_the_reference_is_taken_wide_and_holds_the_truth(bench):
    path = weighed(bench, scatter=1e-4)
    silent, told = analyzed(analyze, path).find("sensitivity"), analyzed(analyze, path, **KNOWN).find("sensitivity")
    assert silent.std > 20 * told.std
    assert covered(silent, 1.0)
    assert any("not given and taken: gravity_std" in note for note in analyzed(analyze, path).notes)


def test_each_part_of_the_budget_shows_the_error_that_it_is_of(bench):
    def part(name, **how):
        return analyzed(analyze, weighed(bench, **how), **KNOWN).find(f"uncertainty_{name}").value

    # a rectangle of half the loop's width; of two constants 20 and 6 ten-thousandths; by the formulas of the GUM
    assert part("hysteresis", hysteresis=0.06) == pytest.approx(0.03 / math.sqrt(3), rel=0.01)
    assert part("repeatability", scatter=0.01) == pytest.approx(0.01, rel=0.4)
    assert part("resolution", step=0.005, noise=0.01) == pytest.approx(math.sqrt(2) * 0.005 / math.sqrt(12), rel=1e-3)
    assert part("zero_drift", drift=0.06, trials=2) == pytest.approx(0.03 / math.sqrt(3), rel=0.1)
    assert 0.005 < part("linearity", bend=0.03) < 0.03 / math.sqrt(3)
    for name in ("hysteresis", "repeatability", "linearity", "zero_drift"):
        assert part(name) < 1e-9


def test_the_parts_add_in_squares_and_few_repeats_widen_the_coverage_factor(bench):
    result = analyzed(analyze, weighed(bench, scatter=0.01, trials=2, signs=(1,), hysteresis=0.002), **KNOWN)
    parts = [item.value for item in result.results if item.name.startswith("uncertainty_")]
    combined, factor = result.find("combined_uncertainty").value, result.find("coverage_factor").value
    assert combined == pytest.approx(math.sqrt(sum(value**2 for value in parts)))
    assert result.find("expanded_uncertainty").value == pytest.approx(factor * combined)
    assert 2.0 < factor < 4.0


@pytest.mark.long
def test_intervals_hold_the_truth_in_95_of_100_times(bench):
    held = 0
    for _ in range(20):
        result = analyzed(analyze, weighed(bench, gain=1.01, scatter=0.003), **KNOWN)
        held += covered(result.find("sensitivity"), 1.01)
    assert held >= 16  # three standard deviations below 19 of 20


def test_what_was_not_done_is_said_and_has_no_number(bench):
    result = analyzed(analyze, weighed(bench, trials=1, signs=(1,), falling=False, scatter=0.001), **KNOWN)
    assert math.isnan(result.find("uncertainty_hysteresis").value)
    assert math.isnan(result.find("uncertainty_repeatability").value)
    assert math.isfinite(result.find("combined_uncertainty").value)
    notes = "\n".join(result.notes)
    for words in ("hysteresis is not known", "repeatability is not known", "weights in one sense only"):
        assert words in notes


def test_a_swapped_sign_and_a_swinging_weight_are_named(bench):
    def swing(columns):
        columns["torque"] = -columns["torque"]
        columns["torque"][40:60] += np.linspace(0.0, 0.5, 20)

    result = analyzed(analyze, weighed(bench, scatter=0.001, edit=swing), **KNOWN)
    assert result.find("sensitivity").value == pytest.approx(-1.0, abs=0.02)
    assert any("the sensor's sign is the other one" in note for note in result.notes)
    assert any("the weight swung or crept in 1 holds" in note for note in result.notes)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"masses": (2.8,), "signs": (1,)}, "found 2 torques of weights; 3 or more are needed"),
        ({"gain": 0.0, "scatter": 0.01}, "the readings do not follow the weights"),
        ({"arm_m": 0.0}, "no hold states the arm of its weights"),
    ],
)
def test_a_run_that_cannot_answer_says_why_in_one_line(bench, how, words):
    with pytest.raises(NotIdentifiable, match=words) as caught:
        analyzed(analyze, weighed(bench, **how))
    assert len(caught.value.faults) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [({"gravity": 1.62}, "gravity 1.62: 9.7 to 9.9"), ({"arm_std_m": -1.0}, "arm_std_m -1: zero or more")],
)
def test_numbers_that_make_no_sense_are_refused(bench, options, words):
    with pytest.raises(InputError, match=words):
        analyzed(analyze, weighed(bench), **options)
