"""Intervals of errors that are not all normal, against draws of them."""

import math

import numpy as np
import pytest

from leactl.analysis.statistics.intervals import half_width, quantisation_step, rounding_limit, rounding_std


@pytest.mark.parametrize(
    ("std", "limits"), [(1.0, ()), (0.0, (1.0,)), (0.1, (1.0,)), (0.5, (1.0,)), (2.0, (1.0,)), (0.0, (1.0, 0.5))]
)
def test_95_of_100_draws_lie_within_the_half_width(std, limits):
    rng = np.random.default_rng(1)
    drawn = rng.normal(0.0, std, 200_000)
    for limit in limits:
        drawn = drawn + rng.uniform(-limit, limit, len(drawn))
    assert np.mean(np.abs(drawn) < half_width(std, math.inf, *limits)) == pytest.approx(0.95, abs=0.006)


def test_few_degrees_of_freedom_widen_it():
    assert half_width(1.0, 4.0) == pytest.approx(2.776, abs=0.001)
    assert half_width(1.0, 4.0, 0.5) > half_width(1.0, math.inf, 0.5)


def test_a_level_that_stays_within_a_step_leaves_half_of_it_and_a_ramp_hardly_any():
    mean = np.full(200, 1 / 200)
    assert rounding_limit(np.full(200, 0.3), 0.1, mean) == pytest.approx(0.05, rel=0.01)
    assert rounding_limit(np.linspace(0.0, 1.0, 200), 0.1, mean) < 0.005
    assert rounding_limit(np.full(200, 0.3), 0.0, mean) == 0.0


def test_noise_of_half_a_step_leaves_nothing_of_its_rounding():
    rng = np.random.default_rng(1)
    still, noisy = (np.round(3.3 + rng.normal(0.0, std, 400)) for std in (0.0, 0.6))
    assert rounding_std(still, 1.0) == pytest.approx(1 / math.sqrt(12))
    assert rounding_std(noisy, 1.0) < 0.01


def test_a_step_is_what_all_readings_are_multiples_apart():
    assert quantisation_step(np.array([0.1, 0.4, 0.2, np.nan, 0.1])) == pytest.approx(0.1)
    assert quantisation_step(np.random.default_rng(1).normal(size=100)) == 0.0
    assert quantisation_step(np.full(5, 2.0)) == 0.0
