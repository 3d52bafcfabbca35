"""Rise times of a few samples: drives that act anywhere in a sample, and loops of several shapes."""

import math

import numpy as np
import pytest

from leactl.analysis.responses.step_metrics import rise_time
from leactl.analysis.responses.step_trials import StepTrial
from leactl.analysis.statistics.regression import CONFIDENCE
from tests.analysis.control_runs import ringing
from tests.loops import current_step

SAMPLE_S = 1e-3
DRAWN = 300
FINE = np.arange(0.0, 0.03, 1e-6)


def first_order(rise, _random):
    return lambda time: 1.0 - np.exp(-2.197 * time / rise)


def leading(rise, _random):
    return lambda time: current_step(time, 2.197 / (2 * math.pi * rise), 0.1, 0.06)


def two_poles(rise, random):
    slow, ratio = 0.4 * rise, random.uniform(0.1, 0.9)
    fast = ratio * slow
    return lambda time: 1.0 - (slow * np.exp(-time / slow) - fast * np.exp(-time / fast)) / (slow - fast)


def second_order(rise, random):
    return ringing(2.2 / rise, random.uniform(0.5, 0.9))


def ramped(rise, random):
    """A first order whose reference is ramped within a sample."""
    lag, ramp = rise / 2.2, random.uniform(0.1, 0.5) * SAMPLE_S

    def held(time):
        return time - lag * (1.0 - np.exp(-time / lag))

    return lambda time: (held(time) - held(np.maximum(time - ramp, 0.0))) / ramp


def errors_of(shape, seed):
    """By how much the rise time is off, and the limit that it gives, for responses of half a sample to three."""
    random = np.random.default_rng(seed)
    errors, limits = np.empty(DRAWN), np.empty(DRAWN)
    for k in range(DRAWN):
        answer, late = shape(random.uniform(0.5, 3.0) * SAMPLE_S, random), random.uniform(0.0, SAMPLE_S)
        fine = answer(FINE)
        true = FINE[np.argmax(fine >= 0.9)] - FINE[np.argmax(fine >= 0.1)]
        time = SAMPLE_S * np.arange(1, 60)
        response = np.where(time > late, answer(np.maximum(time - late, 0.0)), 0.0)
        trial = StepTrial(1.0, time, response, 0.0, 0.05, noise=1e-9, quantum=0.0, error_before=0.0)
        reading = rise_time([trial])
        errors[k], limits[k] = abs(reading.value - true), math.hypot(*reading.shared)
    return errors, limits


SHAPES = (first_order, leading, two_poles, second_order, ramped)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_limit_of_a_rise_time_holds_for_every_shape(shape):
    errors, limits = errors_of(shape, seed=1)
    assert np.mean(errors <= CONFIDENCE * limits) > 0.88
    assert np.median(errors) < 0.4 * SAMPLE_S


def test_over_all_shapes_the_limit_holds_about_as_often_as_it_says():
    held = [errors <= CONFIDENCE * limits for errors, limits in (errors_of(shape, seed=2) for shape in SHAPES)]
    assert 0.92 <= np.mean(held) <= 0.99


def test_a_drive_that_acts_late_in_a_sample_has_not_risen_later():
    time, lag = SAMPLE_S * np.arange(1, 60), 0.5e-3
    results = []
    for late in np.linspace(0.0, 0.99, 9) * SAMPLE_S:
        response = np.where(time > late, 1.0 - np.exp(-(time - late) / lag), 0.0)
        results.append(
            rise_time([StepTrial(1.0, time, response, 0.0, 0.05, noise=1e-9, quantum=0.0, error_before=0.0)]).value
        )
    assert results == pytest.approx([2.197 * lag] * len(results), abs=0.1 * SAMPLE_S)
