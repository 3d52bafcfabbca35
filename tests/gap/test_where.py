"""Regions of a gap, and residuals in bins over a variable."""

import numpy as np
import pytest

from leactl.gap.where import MOST, NARROW, PROFILE_BINS, binned, narrowest


def test_the_narrowest_interval_holds_most_of_the_squares():
    values = np.random.default_rng(1).uniform(0.0, 12.0, 24000)
    low, high, share, part = narrowest(values, np.where((values > 4.0) & (values < 6.0), 1.0, 0.01))
    assert (low, high) == pytest.approx((4.0, 6.0), abs=0.1)
    assert share > MOST
    assert part == pytest.approx(2 / 12, abs=0.01)


def test_an_interval_of_a_direction_is_a_whole_direction():
    values = np.repeat([-1.0, 0.0, 1.0], [500, 10, 490])
    low, high, share, part = narrowest(values, np.where(values > 0.0, 1.0, 0.001))
    assert (low, high) == (1.0, 1.0)
    assert share > 0.99
    assert part == pytest.approx(0.49)


def test_squares_in_both_directions_have_no_narrow_interval():
    values = np.repeat([-1.0, 0.0, 1.0], [500, 10, 490])
    assert narrowest(values, np.where(values == 0.0, 0.001, 1.0))[3] > NARROW


def test_bins_have_mean_and_standard_deviation_of_each_row():
    values = np.linspace(0.0, 10.0, 5000)
    low, high, mean, std = binned(values, np.stack([values, -values, np.tile([-1.0, 1.0], 2500)]))
    assert mean.shape == std.shape == (3, PROFILE_BINS)
    assert mean[0] == pytest.approx((low + high) / 2, abs=0.01)
    assert mean[1] == pytest.approx(-mean[0])
    assert std[2] == pytest.approx(1.0, abs=0.01)


def test_few_levels_have_a_bin_each_and_rare_ones_none():
    values = np.repeat([-1.0, 0.0, 1.0], [50, 3, 40])
    low, high, mean, _ = binned(values, values[None, :])
    assert (low + high) / 2 == pytest.approx([-1.0, 1.0])
    assert mean[0] == pytest.approx([-1.0, 1.0])


def test_too_few_samples_have_no_bins():
    low, _, mean, std = binned(np.arange(3.0), np.zeros((3, 3)))
    assert len(low) == 0
    assert mean.shape == std.shape == (3, 0)
