"""Readings that stand off both their neighbours: RS-232 has no checksum, and a garbled digit is a number still.

The row is written by then; a notice tells of it. A true change of one row's length would be told as well.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

AHEAD = 5.0  # times what lies between the neighbours, by which a reading has to be off their mean


class Outlier(NamedTuple):
    """One reading, and what its neighbours have."""

    what: str
    value: float
    before: float
    after: float

    def __str__(self) -> str:
        return (
            f"{self.what} of {self.value:.6g} between {self.before:.6g} and {self.after:.6g}: a digit may have been"
            " garbled on the line"
        )


class Outliers:
    """Looks back on each reading once the next has come; quantities by name, with what their noise stays within."""

    def __init__(self, noise: Sequence[tuple[str, float]]) -> None:
        self._noise = tuple(noise)
        self._before = self._latest = (math.nan,) * len(self._noise)
        self.count = 0

    def see(self, values: Sequence[float]) -> Outlier | None:
        """Take the readings of a row, and tell the first of the row before that is off."""
        outlier = None
        for (what, noise), before, value, after in zip(self._noise, self._before, self._latest, values, strict=True):
            if abs(value - 0.5 * (before + after)) > AHEAD * abs(after - before) + noise:  # NaN compares false
                self.count += 1
                outlier = outlier or Outlier(what, value, before, after)
        self._before, self._latest = self._latest, tuple(values)
        return outlier
