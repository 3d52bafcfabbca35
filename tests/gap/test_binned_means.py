"""Residuals over one variable: where bins lie, which sign they are counted along, how wide their intervals are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.gap.binned_means import best_sign, bin_edges, bin_of, first_that_follows, fold_angle, means

RANDOM = np.random.default_rng(4)
SPEED = RANDOM.uniform(-30.0, 30.0, 4000)


def test_bins_are_fine_where_an_effect_acts_and_end_where_it_has_faded():
    fading = np.exp(-np.abs(SPEED) / 0.3) * np.sign(SPEED)
    edges = bin_edges(SPEED, fading, 16)
    assert edges[0] == pytest.approx(-edges[-1], rel=0.4)
    assert 0.5 < edges[-1] < 5.0
    assert np.max(np.diff(edges)) < 1.5
    assert np.ptp(bin_edges(SPEED, np.ones_like(SPEED), 16)) > 59.0


def test_few_levels_have_a_bin_each():
    edges = bin_edges(np.repeat([-1.0, 1.0], [300, 40]), np.ones(340), 16)
    assert len(edges) == 3
    assert bin_of(np.array([-1.0, 1.0]), edges).tolist() == [0, 1]


@given(st.floats(1e-6, 1e6), st.floats(1e-6, 1e6))
def test_bins_and_means_are_those_of_a_similar_machine(by, size):
    part = np.sin(SPEED)
    edges = bin_edges(SPEED, part, 12)
    groups = np.arange(4000) // 50
    here = means(part, bin_of(SPEED, edges), groups, len(edges) - 1)
    similar = bin_edges(SPEED * by, part * size, 12)
    there = means(part * size, bin_of(SPEED * by, similar), groups, len(similar) - 1)
    assert similar == pytest.approx(edges * by, rel=1e-9)
    assert there.mean == pytest.approx(here.mean * size, rel=1e-6)
    assert there.high == pytest.approx(here.high * size, rel=1e-6)
    assert there.off_zero == here.off_zero


def test_what_turns_round_with_the_motion_is_counted_along_it():
    angle = fold_angle(RANDOM.uniform(-50.0, 50.0, 4000), 3.0)
    wave, sign = np.sin(3.0 * angle), np.sign(SPEED)
    place = bin_of(angle, bin_edges(angle, wave, 12))
    assert angle.min() >= 0.0 and angle.max() <= 2.0 * np.pi / 3.0
    assert best_sign(wave, place, {"velocity": sign}).name == ""
    along = best_sign(wave * sign, place, {"velocity": sign})
    assert along.name == "velocity"
    assert along.explained > 0.9


def test_an_interval_counts_a_stretch_of_like_rows_once():
    place = np.zeros(4000, np.intp)
    held = 0
    for _ in range(300):
        values = np.repeat(RANDOM.standard_normal(40), 100)
        result = means(values, place, np.arange(4000) // 100, 1)
        held += result.off_zero == 0
    assert 0.9 < held / 300 < 0.99
    alone = means(values, place, np.zeros(4000, np.intp), 1)
    assert np.isnan(alone.low[0]) and np.isfinite(alone.mean[0])


def test_the_first_variable_that_tells_enough_is_taken():
    assert first_that_follows([0.2, 0.6, 0.9], float) == 0.6
    assert first_that_follows([0.2, 0.3, 0.1], float) == 0.3
    assert first_that_follows([], float) is None
