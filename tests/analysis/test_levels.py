"""Means of held levels and their standard errors."""

import numpy as np
import pytest

from leactl.analysis.signals.levels import Hold, HoldMeans, require_levels, settled_mean, standard_error
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel


def channel(time, values, sampling="instant"):
    return Channel(
        np.asarray(time, float), np.asarray(values, float), "torque", "test", "N*m", "", "", "", sampling, "loop"
    )


def autoregressive(rng, count, memory):
    noise = rng.normal(size=count)
    values = np.empty(count)
    values[0] = noise[0] / np.sqrt(1 - memory**2)
    for index in range(1, count):
        values[index] = memory * values[index - 1] + noise[index]
    return values


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_the_standard_error_is_the_spread_of_means_also_where_samples_remember(memory):
    rng = np.random.default_rng(4)
    records = [autoregressive(rng, 800, memory) for _ in range(150)]
    spread = np.std([record.mean() for record in records])
    assert np.median([standard_error(record) for record in records]) == pytest.approx(spread, rel=0.2)


def test_gaps_and_repeats_do_not_pass_for_evidence():
    rng = np.random.default_rng(5)
    values = rng.normal(size=1000)
    each_twice = standard_error(np.repeat(values, 2))
    assert each_twice == pytest.approx(standard_error(values), rel=0.1)
    values[rng.random(1000) < 0.5] = np.nan
    assert standard_error(values) == pytest.approx(1 / np.sqrt(500), rel=0.15)
    assert standard_error(np.full(100, 0.1)) == 0.0


def test_an_infinite_sample_counts_as_a_gap():
    values = np.random.default_rng(3).normal(size=500)
    values[7] = np.inf
    gap = np.where(np.isinf(values), np.nan, values)
    assert standard_error(values) == standard_error(gap) > 0.0


def test_an_instant_counts_from_start_to_before_stop():
    result = settled_mean(channel(np.arange(10.0), np.arange(10.0)), 2.0, 6.0)
    assert (result.value, result.samples, result.quarters) == (3.5, 4, (2.0, 3.0, 4.0, 5.0))


def test_a_mean_over_an_interval_counts_where_the_whole_interval_is_inside():
    result = settled_mean(channel(np.arange(10.0), np.arange(10.0), "mean"), 2.0, 6.0)
    assert (result.value, result.samples) == (4.5, 4)  # stamps 3 to 6


def test_missed_samples_are_counted_and_not_averaged():
    result = settled_mean(channel(np.arange(10.0), [np.nan, 1, 1, np.nan, 1, 1, 1, 1, 1, 9]), 0.0, 9.0)
    assert (result.value, result.samples, result.missing) == (1.0, 7, 2)


@pytest.mark.parametrize("stop", [2.0, 40.0])
def test_too_few_samples_or_a_record_that_ends_too_soon_give_no_mean(stop):
    assert settled_mean(channel(np.arange(10.0), np.arange(10.0)), 0.0, stop) is None


def hold_means(setpoint, unit):
    """Two holds at one setpoint, of a velocity."""
    holds = tuple(Hold(setpoint, 0, start, start + 1.0, unit) for start in (0.0, 1.0))
    column = np.array([setpoint, setpoint])
    return HoldMeans(
        np.zeros(2, int), column, np.zeros(2, int), {"velocity": column}, {"velocity": 0.0 * column}, {}, holds, {}
    )


def test_one_level_is_refused_in_the_unit_of_its_setpoint():
    with pytest.raises(NotIdentifiable, match=r"run\.h5: found one level \(20 rad/s in 2 holds\); two distinct levels"):
        require_levels("run.h5", "velocity", "velocity", hold_means(20.0, "rad/s"))
