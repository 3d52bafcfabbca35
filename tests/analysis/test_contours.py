"""Contour lines against surfaces whose lines are known."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.analysis.efficiency.contours import band_polygons, contours

X, Y = np.meshgrid(np.linspace(-1.5, 1.5, 31), np.linspace(-1.5, 1.5, 31), indexing="ij")


def test_a_cone_has_one_closed_circle():
    [(x, y)] = contours(X, Y, np.hypot(X, Y), 1.0)
    np.testing.assert_allclose(np.hypot(x, y), 1.0, atol=2e-3)
    assert (x[0], y[0]) == (x[-1], y[-1])
    assert np.ptp(np.unwrap(np.arctan2(y, x))) == pytest.approx(2.0 * np.pi)


def test_a_plane_over_a_skewed_grid_has_a_straight_line_from_edge_to_edge():
    skewed = Y + 0.3 * X
    [(x, y)] = contours(X, skewed, 2.0 * X - skewed, 0.0)
    np.testing.assert_allclose(y, 2.0 * np.array(x), atol=1e-9)
    assert np.ptp(x) == pytest.approx(3.0 / 1.7)  # where y - 0.3 x leaves +-1.5


def test_no_line_goes_through_what_is_not_known():
    z = np.where(np.abs(X) < 0.25, np.nan, Y)
    lines = contours(X, Y, z, 0.05)
    assert len(lines) == 2
    assert all(abs(value) > 0.2 for x, _ in lines for value in x)
    assert contours(X, Y, Y, 9.0) == []


def area(polygons):
    """Sum of the polygons' areas, by the corners in turn (Meister 1769)."""
    corners = [np.array(polygon) for polygon in polygons]
    return sum(
        abs(np.dot(corner[:, 0], np.roll(corner[:, 1], -1)) - np.dot(corner[:, 1], np.roll(corner[:, 0], -1))) / 2
        for corner in corners
    )


@given(levels=st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=8, unique=True), seed=st.integers(0, 999))
def test_bands_of_any_surface_cover_the_grid_once(levels, seed):
    z = np.random.default_rng(seed).normal(size=(4, 5))
    x, y = np.meshgrid(np.arange(4.0), np.arange(5.0), indexing="ij")
    edges = [-np.inf, *sorted(levels), np.inf]
    assert sum(area(band_polygons(x, y, z, *pair)) for pair in itertools.pairwise(edges)) == pytest.approx(12.0)


def test_a_band_of_a_plane_is_as_wide_as_its_levels_are_apart():
    polygons = band_polygons(X, Y, X, -0.3, 0.72)
    assert area(polygons) == pytest.approx(3.0 * 1.02)
    assert all(-0.3 - 1e-12 <= x <= 0.72 + 1e-12 for polygon in polygons for x, _ in polygon)


def test_a_band_leaves_out_what_is_not_known():
    assert area(band_polygons(X, Y, np.where(X > 0.05, np.nan, Y), -np.inf, np.inf)) == pytest.approx(3.0 * 1.5)
