"""Lines in a spectrum: what stands out of noise of any colour, and what must not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from leactl.gap.search.ringing import FULL, SEGMENT, highest_bin, highest_line, periodograms
from leactl.gap.verdict.judge import LINE

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


@pytest.mark.parametrize(("missing", "expected"), [(0.9 * (1.0 - FULL), True), (1.1 * (1.0 - FULL), False)])
def test_segments_with_too_much_missing_are_left_out(missing, expected):
    values = np.ones(SEGMENT)
    values[: round(missing * SEGMENT)] = np.nan
    assert bool(periodograms(values)) is expected


@given(seed=st.integers(0, 2**32 - 1))
def test_a_loud_run_of_few_segments_makes_no_line_among_many_quiet_ones(seed):
    draw = np.random.default_rng(seed)
    quiet = periodograms(0.15 * draw.standard_normal(6000))
    loud = periodograms(draw.standard_normal(20 * SEGMENT // 2))
    assert highest_line(quiet + loud)[1] < LINE


@pytest.mark.parametrize("loudness", [0.0, 8.0, 30.0])
@given(seed=st.integers(0, 2**32 - 1), at=st.floats(6.0, 26.0))
def test_a_tone_of_many_quiet_segments_stays_a_line_beside_a_loud_run(loudness, seed, at):
    draw = np.random.default_rng(seed)
    tone = 0.5 * np.sin(2.0 * np.pi * at / SEGMENT * np.arange(ROWS))
    loud = periodograms(loudness * draw.standard_normal(3 * SEGMENT))
    found, height = highest_line(periodograms(draw.standard_normal(ROWS) + tone) + loud)
    assert height > LINE
    assert abs(found - at) <= 1.0


def test_segments_without_any_power_make_no_line():
    assert highest_line([np.zeros(SEGMENT // 2 + 1)] * 9) == (0, 0.0)
