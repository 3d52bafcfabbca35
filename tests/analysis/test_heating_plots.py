"""Curves of a thermal fit: thinned to what a plot can show, and empty where nothing was measured."""

import numpy as np

from leactl.analysis.heating.plots import MOST_POINTS, thinned_curve


def test_a_curve_is_thinned_by_means_over_its_finite_values():
    time = np.arange(1000.0)
    curve = thinned_curve("winding", time, np.where(time < 500.0, 2.0, np.nan))
    assert len(curve.x) == MOST_POINTS
    assert max(curve.x) < 500.0
    assert set(curve.y) == {2.0}


def test_a_temperature_that_was_never_measured_is_an_empty_curve():
    curve = thinned_curve("housing", np.arange(10.0), np.full(10, np.nan))
    assert (curve.label, curve.x, curve.y) == ("housing", (), ())
