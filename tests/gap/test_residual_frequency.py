"""A frequency in what is left over: found between the bins of a transform, across gaps, and not where there is none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.gap.verdict.residual_frequency import FEWEST_PERIODS, ResidualCourse, gains, strongest_frequency
from leactl.gap.verdict.state_regression import LEAST_CERTAINTY, certainty
from leactl.gap.verdict.unknown import LEAST_SLOW_SHARE

STRETCHES = 24


def course(left_of, duration=20.0, step=0.01, seed=0, kept=0.8):
    """Rows of a run, a fifth of them masked as rows around reversals are."""
    rng = np.random.default_rng(seed)
    time = 3.0 + np.flatnonzero(rng.random(round(duration / step)) < kept) * step
    return ResidualCourse(time, left_of(time, rng), (np.arange(len(time)) * STRETCHES // len(time)).astype(np.intp))


def humming(hertz, noise):
    return lambda time, rng: np.sin(2.0 * np.pi * hertz * time + rng.uniform(0, 6)) + noise * rng.normal(size=len(time))


@given(hertz=st.floats(0.6, 40.0), noise=st.floats(0.0, 2.0), durations=st.tuples(*[st.floats(15.0, 40.0)] * 2))
def test_any_frequency_is_found_and_explains_runs_of_another_phase(hertz, noise, durations):
    fitted = [course(humming(hertz, noise), duration, seed=k) for k, duration in enumerate(durations)]
    result = strongest_frequency(fitted)
    assert result == pytest.approx(hertz, abs=0.2 / max(durations))
    other = course(humming(hertz, noise), seed=7)
    explained = gains(other, result)
    assert explained.sum() == pytest.approx(
        0.5 * len(other.time), rel=0.25, abs=6.0 * noise * np.sqrt(0.5 * len(other.time))
    )
    assert certainty(explained, other.stretch) >= LEAST_CERTAINTY


def coloured(time, rng):
    return np.convolve(rng.normal(size=len(time) + 99), np.ones(100) / 10.0, "valid")


@pytest.mark.parametrize("left_of", [lambda time, rng: rng.normal(size=len(time)), coloured])
def test_noise_of_any_colour_repeats_by_no_frequency_of_another_run(left_of):
    taken_for_one = 0
    for seed in range(40):
        result = strongest_frequency([course(left_of, seed=3 * seed + k) for k in range(2)])
        other = course(left_of, seed=3 * seed + 2)
        explained = gains(other, result)
        enough = explained.sum() > LEAST_SLOW_SHARE * np.sum(other.residual**2)
        taken_for_one += enough and certainty(explained, other.stretch) >= LEAST_CERTAINTY
    assert taken_for_one == 0


def test_less_than_a_few_periods_is_a_slow_change_and_no_frequency():
    slow = course(humming(0.5 * FEWEST_PERIODS / 20.0, 0.0))
    assert strongest_frequency([slow]) >= FEWEST_PERIODS / slow.duration
    short = ResidualCourse(np.array([0.0, 0.1, 0.2]), np.array([1.0, 0.0, 1.0]), np.array([0, 1, 2]))
    assert strongest_frequency([short]) is None


def test_a_run_of_one_stretch_is_not_judged_by_itself():
    whole = course(humming(2.0, 0.0))
    assert not gains(ResidualCourse(whole.time, whole.residual, np.zeros_like(whole.stretch)), 2.0).any()
