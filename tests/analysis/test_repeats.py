"""Rows of equal readings."""

import numpy as np

from leactl.analysis.quality.repeated_readings import rows


def test_readings_beyond_all_numbers_are_equal_readings_too():
    new, lengths = rows(np.array([1.0, np.inf, np.inf, -np.inf, np.nan, np.nan, 2.0]))
    assert new.tolist() == [True, True, False, True, True, True, True]
    assert lengths.tolist() == [1, 2, 1, 1, 1, 1]
