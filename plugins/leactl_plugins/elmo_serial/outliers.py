"""Detect readings that differ from both neighbours: RS-232 has no checksum, and a garbled digit still gives a number.

The row is already written when its outlier is found; a notice reports it. A true change for a single row is reported as
well.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

OUTLIER_FACTOR = 5.0  # least deviation of an outlier from the mean of its neighbours, over the difference of these


class Outlier(NamedTuple):
    """A reading with its two neighbours."""

    quantity: str
    value: float
    before: float
    after: float

    def __str__(self) -> str:
        return (
            f"{self.quantity} of {self.value:.6g} between {self.before:.6g} and {self.after:.6g}: a digit may have been"
            " garbled on the line"
        )


class Outliers:
    """Check of each reading when the next one arrives; `noise_bounds` has name and noise bound of each quantity."""

    def __init__(self, noise_bounds: Sequence[tuple[str, float]]) -> None:
        self._noise_bounds = tuple(noise_bounds)
        self._previous_row = self._latest_row = (math.nan,) * len(self._noise_bounds)
        self.count = 0

    def add(self, values: Sequence[float]) -> Outlier | None:
        """Add the readings of a row; return the first outlier of the previous row, or None."""
        outlier = None
        for (quantity, noise_bound), before, value, after in zip(
            self._noise_bounds, self._previous_row, self._latest_row, values, strict=True
        ):
            # NaN compares false
            if abs(value - 0.5 * (before + after)) > OUTLIER_FACTOR * abs(after - before) + noise_bound:
                self.count += 1
                outlier = outlier or Outlier(quantity, value, before, after)
        self._previous_row, self._latest_row = self._latest_row, tuple(values)
        return outlier
