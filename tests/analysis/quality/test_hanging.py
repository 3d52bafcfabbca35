"""The longest row of equal readings of a record."""

import numpy as np

from leactl.analysis.quality.hanging import RepeatedReading, longest_repeat


def test_an_empty_record_repeats_no_reading():
    assert longest_repeat(np.array([])) is None


def test_the_longest_row_of_finite_readings_counts():
    assert longest_repeat(np.array([1.0, 2.0, 2.0, np.nan, np.nan, 3.0, 3.0, 3.0])) == RepeatedReading(5, 7, 3.0)
    assert longest_repeat(np.array([1.0, 2.0, 1.0])) is None
