"""Contour lines against surfaces whose lines are known."""

import numpy as np
import pytest

from leactl.analysis.powers.contours import contours

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
