"""Regions of a gap, and residuals in bins over a variable."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from leactl.gap.diagnosis import Cause, EffectParameter, Region, Where
from leactl.gap.replay.comparison import Compared
from leactl.gap.signals.record import Clocked, Record
from leactl.gap.verdict.where import (
    MOST_REGION_DATA,
    PROFILE_BINS,
    REGION_SHARE,
    bin_statistics,
    narrowest_interval,
    profiles,
    where,
)


def test_the_narrowest_interval_holds_most_of_the_squares():
    values = np.random.default_rng(1).uniform(0.0, 12.0, 24000)
    low, high, share, part = narrowest_interval(values, np.where((values > 4.0) & (values < 6.0), 1.0, 0.01))
    assert (low, high) == pytest.approx((4.0, 6.0), abs=0.1)
    assert share > REGION_SHARE
    assert part == pytest.approx(2 / 12, abs=0.01)


def test_an_interval_of_a_direction_is_a_whole_direction():
    values = np.repeat([-1.0, 0.0, 1.0], [500, 10, 490])
    low, high, share, part = narrowest_interval(values, np.where(values > 0.0, 1.0, 0.001))
    assert (low, high) == (1.0, 1.0)
    assert share > 0.99
    assert part == pytest.approx(0.49)


def test_squares_in_both_directions_have_no_narrow_interval():
    values = np.repeat([-1.0, 0.0, 1.0], [500, 10, 490])
    assert narrowest_interval(values, np.where(values == 0.0, 0.001, 1.0))[3] > MOST_REGION_DATA


def test_bins_have_mean_and_standard_deviation_of_each_row():
    values = np.linspace(0.0, 10.0, 5000)
    low, high, mean, std = bin_statistics(values, np.stack([values, -values, np.tile([-1.0, 1.0], 2500)]))
    assert mean.shape == std.shape == (3, PROFILE_BINS)
    assert mean[0] == pytest.approx((low + high) / 2, abs=0.01)
    assert mean[1] == pytest.approx(-mean[0])
    assert std[2] == pytest.approx(1.0, abs=0.01)


def test_few_levels_have_a_bin_each_and_rare_ones_none():
    values = np.repeat([-1.0, 0.0, 1.0], [50, 3, 40])
    low, high, mean, _ = bin_statistics(values, values[None, :])
    assert (low + high) / 2 == pytest.approx([-1.0, 1.0])
    assert mean[0] == pytest.approx([-1.0, 1.0])


def test_too_few_samples_have_no_bins():
    low, _, mean, std = bin_statistics(np.arange(3.0), np.zeros((3, 3)))
    assert len(low) == 0
    assert mean.shape == std.shape == (3, 0)


def test_a_gap_that_an_effect_closes_is_told_by_what_it_acts_in_and_not_by_a_proxy():
    """Cogging that shows least while the winding is hot: the temperature would be the narrower region."""
    time = np.arange(20000) / 1000.0
    angle, temperature = 7.0 * time, 25.0 + time
    wave = 0.1 * np.sin(14.0 * angle) * np.where(temperature > 37.0, 0.2, 1.0)
    noise = np.random.default_rng(2).normal(0.0, 0.003, len(time))
    values = {("angle", "test"): angle, ("winding_temperature", "test"): temperature}
    record = Record(Path("run.h5"), "grid", "coupled", Clocked(time, 1e-3, values), None, {})
    order = EffectParameter("order", 14.0, 0.0, "1")
    cogging = Cause("cogging", 0.99, 1.0, (EffectParameter("amplitude", 0.1, 0.0, "N*m"), order))

    def located(augmented, effects):
        replayed = (np.zeros_like(wave), np.zeros_like(wave), augmented)
        channel = compared(time, wave + noise, *replayed)
        return where([record], [channel], effects)[0]

    told = located(wave, (cogging,))
    assert (told.region.variable, told.region.within_turn) == ("angle", True)
    assert 0.0 <= told.region.low < told.region.high <= 2.0 * np.pi
    assert told.share >= REGION_SHARE
    assert located(wave, ()).region.variable in ("winding_temperature", "time")
    assert located(0.05 * wave, (cogging,)).region.variable != "angle"  # it leaves nearly all of it


def compared(time, measured, *replayed):
    index, block = np.arange(len(time)), (time // 1.0).astype(int)
    of_run = ("run", "grid", "coupled", "torque", "test")
    return Compared(*of_run, time, index, block, measured, replayed, replayed[2], 3e-3, False)


def test_a_spring_over_several_turns_is_told_over_the_whole_angle():
    """A stop that is met beyond 14 rad alone, after more than two turns, shows nothing within a turn."""
    time = np.arange(20000) / 1000.0
    angle = 20.0 * np.sin(1.7 * time)
    pull = np.maximum(np.abs(angle) - 14.0, 0.0)
    record = Record(Path("run.h5"), "grid", "coupled", Clocked(time, 1e-3, {("angle", "test"): angle}), None, {})
    channel = compared(time, pull, 0.0 * pull, 0.0 * pull, pull)
    [told] = where([record], [channel], [Cause("position_spring", 0.99, 1.0, ())])
    assert (told.region.variable, told.region.within_turn) == ("angle", False)
    assert told.region.high > 14.0
    [profile] = profiles([record], [channel], [told])
    assert profile.low[0] < -19.0
    assert profile.high[-1] > 19.0


def test_a_profile_of_a_region_within_a_turn_is_within_a_turn():
    time = np.arange(20000) / 1000.0
    angle = 7.0 * time
    wave = 0.1 * np.sin(angle)
    record = Record(Path("run.h5"), "grid", "coupled", Clocked(time, 1e-3, {("angle", "test"): angle}), None, {})
    channel = compared(time, wave, 0.0 * wave, 0.0 * wave, wave)
    [told] = where([record], [channel], [Cause("unbalance", 0.99, 1.0, ())])
    assert told.region.within_turn
    [profile] = profiles([record], [channel], [told])
    assert 0.0 <= profile.low[0] < profile.high[-1] <= 2.0 * np.pi
    middle = (profile.low + profile.high) / 2.0
    assert profile.mean[1] == pytest.approx(0.1 * np.sin(middle), abs=0.005)


def test_a_profile_is_over_the_region_s_variable_with_mean_and_spread_of_each_model():
    time = np.arange(4000) / 100.0
    angle, random = np.mod(3.0 * time, 6.0), np.random.default_rng(6)
    values = {("angle", "test"): angle}
    record = Record(Path("run.h5"), "grid", "coupled", Clocked(time, 1e-2, values), None, {})
    noise = random.normal(0.0, 0.2, len(time))
    replayed = tuple(np.full_like(time, offset) for offset in (-1.0, -0.5, 0.0))
    channel = compared(time, noise, *replayed)
    entry = Where("torque", "test", "coupled", "N*m", 1.0, 0.5, 0.1, Region("angle", 1.0, 2.0, "rad"), 0.9)
    sound = Where("torque", "test", "coupled", "N*m", 0.1, 0.1, 0.1)
    over_angle, over_time = profiles([record], [channel], [entry, sound, dataclasses.replace(entry, region=None)])
    assert (over_angle.variable, over_angle.variable_units) == ("angle", "rad")
    assert (over_time.variable, over_time.variable_units) == ("time", "s")
    for profile in (over_angle, over_time):
        assert profile.mean.mean(axis=1) == pytest.approx([1.0, 0.5, 0.0], abs=0.02)
        assert profile.std.mean(axis=1) == pytest.approx([0.2] * 3, rel=0.1)
    assert over_angle.high[-1] <= 6.0 < over_time.high[-1]


def test_a_single_level_has_one_bin():
    low, high, mean, _ = bin_statistics(np.full(20, 2.0), np.full((3, 20), 0.5))
    assert (low.tolist(), high.tolist(), mean.tolist()) == ([1.5], [2.5], [[0.5]] * 3)
