"""An end of range is told from noise, from a coarse sensor and from a level that is merely constant."""

from dataclasses import replace

import numpy as np
import pytest

from leactl.analysis.quality.saturation import find_saturation
from leactl.analysis.signals.levels import Hold
from leactl.runfile.read.reader import Channel

LEVELS = (2.0, 4.0, 6.0, 8.0)
COUNT = 0.000375


def record(noise, count, low=-np.inf, high=np.inf, seed=0, rate=200):
    """Four holds of one second through a sensor of this resolution and range."""
    rng = np.random.default_rng(seed)
    values = np.repeat(LEVELS, rate) + rng.normal(0.0, noise, 4 * rate)
    values = np.clip(np.round(values / count) * count, low, high)
    holds = [Hold(level, 0, float(k), k + 1.0) for k, level in enumerate(LEVELS)]
    stamps = np.arange(4 * rate) / rate
    return Channel(stamps, values, "torque", "test", "N*m", "", "", "", "instant", "loop"), holds


@pytest.mark.parametrize("rate", [40, 200])
@pytest.mark.parametrize("noise", [0.0, 0.0001, 0.0005, 0.005, 0.2])
def test_readings_within_the_range_are_not_taken_for_its_end(noise, rate):
    for seed in range(40):
        assert find_saturation(*record(noise, COUNT, seed=seed, rate=rate))[1] == []


def test_few_readings_that_gather_at_an_extreme_by_chance_are_no_end_of_range():
    """Twenty of each hold, through steps about as large as their noise."""
    assert [seed for seed in range(800) if find_saturation(*record(1.1 * 0.0137, 0.0137, seed=seed, rate=20))[1]] == []
    channel, holds = record(2.0 * 0.0137, 0.0137, high=7.0, rate=20)
    assert find_saturation(channel, holds) == (7.0, [holds[3]])


@pytest.mark.parametrize("noise", [0.002, 0.005, 0.2])
def test_holds_at_the_end_of_the_range_are_found(noise):
    channel, holds = record(noise, COUNT, high=7.0)
    assert find_saturation(channel, holds) == (7.0, [holds[3]])
    channel, holds = record(noise, COUNT, low=5.0)
    assert find_saturation(channel, holds) == (5.0, holds[:2])


def test_without_noise_two_levels_that_read_the_same_tell():
    channel, holds = record(0.0, COUNT, high=5.0)
    assert find_saturation(channel, holds) == (5.0, holds[2:])


def test_a_mean_that_is_only_half_cut_off_is_found():
    channel, holds = record(0.01, COUNT, high=8.0)
    assert find_saturation(channel, holds) == (8.0, [holds[3]])


def test_a_model_s_value_that_comes_to_rest_is_no_end_of_range():
    channel, holds = record(0.0, 1e-9)
    since = channel.time % 1.0
    for settled in (0.02, 0.1):  # s: until the last digit stays, and while it still moves
        values = channel.values * (1.0 - np.exp(-since / settled))
        values[since > 0.7] = channel.values[since > 0.7]
        assert find_saturation(replace(channel, values=values), holds)[1] == []
