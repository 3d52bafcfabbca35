"""What a channel shows of its own noise: size, colour, rounding, and nothing of its signal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from leactl.gap.signals.noise import coloured_noise, noise_of, quantum_of

COUNT = 20_000


def drawn_again(values, quantum=0.0):
    return coloured_noise(values, quantum, np.random.default_rng(1))


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-6, 1e6), st.floats(0.0, 50.0), st.integers(0, 1000))
def test_white_noise_is_drawn_again_at_its_size_whatever_moves_slowly_beside_it(size, slow, seed):
    time = np.linspace(0.0, 1.0, COUNT)
    noise = size * np.random.default_rng(seed).standard_normal(COUNT)
    again = drawn_again(noise + slow * size * np.sin(2.0 * np.pi * time))
    assert np.std(again) == pytest.approx(size, rel=0.1)


@pytest.mark.parametrize("width", [8, 64, 256])
def test_noise_reaches_down_to_the_slowest_however_little_a_segment_tells_of_it(width):
    noise = np.random.default_rng(4).standard_normal(COUNT)
    whole = COUNT // width * width
    slow, again = (np.std(np.mean(item[:whole].reshape(-1, width), axis=1)) for item in (noise, drawn_again(noise)))
    assert again == pytest.approx(slow, rel=0.35)


def test_a_filters_colour_is_kept():
    """But for what is below a quarter of the band, where noise is taken to be as in the quarter above."""
    white = np.random.default_rng(2).standard_normal(COUNT)
    filtered = lfilter([0.5, 0.5], [1.0], white)
    again = drawn_again(filtered)
    assert np.std(again) == pytest.approx(np.std(filtered), rel=0.15)
    assert np.corrcoef(again[1:], again[:-1])[0, 1] == pytest.approx(0.5, abs=0.15)


def test_a_line_and_a_leap_are_no_noise():
    time = np.arange(COUNT)
    noise = np.random.default_rng(3).standard_normal(COUNT)
    moved = noise + 5.0 * np.sin(2.0 * np.pi * 0.3 * time) + 100.0 * (time > COUNT / 2)
    assert np.std(drawn_again(moved)) == pytest.approx(1.0, rel=0.15)


def test_rounding_is_not_drawn_as_noise():
    step = 0.25
    fast = np.round(1e3 * np.sin(np.arange(COUNT) / 300.0) / step) * step
    quantum = quantum_of(fast)
    assert quantum == pytest.approx(step)
    assert np.std(drawn_again(fast, quantum)) < 0.05 * step
    assert noise_of(fast, quantum) >= step / np.sqrt(12.0)


def test_few_samples_show_none():
    assert not drawn_again(np.ones(20)).any()
