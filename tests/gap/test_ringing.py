"""Lines in a spectrum: what stands out of noise of any colour, and what must not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from leactl.effects.contract import Signals
from leactl.gap.search.regression import Rows
from leactl.gap.search.ringing import (
    LEAST_VALID_SHARE,
    SEGMENT,
    highest_bin,
    highest_line,
    periodograms,
    without_followed_part,
)
from leactl.gap.verdict.judge import EVEN_LINE_HEIGHT
from leactl.model.nominal import Model

ROWS = 12_000


def spectrum(values):
    return np.mean(periodograms(values), axis=0)


@given(seed=st.integers(0, 2**32 - 1), decay=st.floats(0.0, 0.95))
def test_noise_of_any_slope_has_no_line(seed, decay):
    noise = np.random.default_rng(seed).standard_normal(ROWS)
    assert highest_bin(spectrum(lfilter([1.0], [1.0, -decay], noise)))[1] < 1.5


@given(seed=st.integers(0, 2**32 - 1), at=st.floats(6.0, 26.0))
def test_a_tone_far_below_the_noise_is_found_where_it_is(seed, at):
    draw = np.random.default_rng(seed)
    tone = 0.35 * np.sin(2.0 * np.pi * at / SEGMENT * np.arange(ROWS))  # 6 % of the power of the noise
    found, height = highest_bin(spectrum(draw.standard_normal(ROWS) + tone))
    assert height > 1.5
    assert abs(found - at) <= 1.0


@pytest.mark.parametrize(
    ("missing", "expected"), [(0.9 * (1.0 - LEAST_VALID_SHARE), True), (1.1 * (1.0 - LEAST_VALID_SHARE), False)]
)
def test_segments_with_too_much_missing_are_left_out(missing, expected):
    values = np.ones(SEGMENT)
    values[: round(missing * SEGMENT)] = np.nan
    assert bool(periodograms(values)) is expected


@given(seed=st.integers(0, 2**32 - 1))
def test_a_loud_run_of_few_segments_makes_no_line_among_many_quiet_ones(seed):
    draw = np.random.default_rng(seed)
    quiet = periodograms(0.15 * draw.standard_normal(6000))
    loud = periodograms(draw.standard_normal(20 * SEGMENT // 2))
    assert highest_line(quiet + loud)[1] < EVEN_LINE_HEIGHT


@pytest.mark.parametrize(
    "loudness", [pytest.param(0.0, marks=pytest.mark.long), 8.0, pytest.param(30.0, marks=pytest.mark.long)]
)
@given(seed=st.integers(0, 2**32 - 1), at=st.floats(6.0, 26.0))
def test_a_tone_of_many_quiet_segments_stays_a_line_beside_a_loud_run(loudness, seed, at):
    draw = np.random.default_rng(seed)
    tone = 0.5 * np.sin(2.0 * np.pi * at / SEGMENT * np.arange(ROWS))
    loud = periodograms(loudness * draw.standard_normal(3 * SEGMENT))
    found, height = highest_line(periodograms(draw.standard_normal(ROWS) + tone) + loud)
    assert height > EVEN_LINE_HEIGHT
    assert abs(found - at) <= 1.0


def test_segments_without_any_power_make_no_line():
    assert highest_line([np.zeros(SEGMENT // 2 + 1)] * 9) == (0, 0.0)


@pytest.mark.parametrize(("equation", "left"), [("velocity", False), ("free_torque", True)])
def test_what_a_filter_leaves_of_a_motion_is_no_line_of_a_velocity(equation, left):
    """A velocity filter that the model has a tenth of a percent off leaves the lines of the motion itself."""
    time = 0.0025 * np.arange(ROWS)
    motion = 5.0 * np.sin(2.0 * np.pi * 43.75 * time)  # at bin 7
    own = 0.02 * np.sin(2.0 * np.pi * 125.0 * time)  # at bin 20, where nothing moves
    residual = 1e-3 * np.gradient(motion) + 1e-3 * np.random.default_rng(2).standard_normal(ROWS)
    signals = Signals("free", time, Model(name="m"), 0.0025, velocity=motion)
    index = np.arange(ROWS)
    rows = Rows("r", "k", "free", equation, "velocity", "test", "rad/s", residual, {}, {}, index, index, signals, 1e-3)
    found, height = highest_bin(spectrum(without_followed_part(rows, residual)))
    assert (found == 7 and height > EVEN_LINE_HEIGHT) is left
    found, height = highest_bin(spectrum(without_followed_part(rows, residual + own)))
    assert height > EVEN_LINE_HEIGHT
    assert found == 20 or left
