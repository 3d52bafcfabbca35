"""A result over many runs: limits within which it stays by chance, and what speaks for a change.

Individuals and moving ranges: ISO 7870-2:2013. Nine in a row on one side: Nelson, "The Shewhart control chart: tests
for special causes", Journal of Quality Technology 16 (1984), test 2.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
RANGES_TO_SIGMA = 1.128  # d2 of two values: mean moving range over standard deviation
WIDTH = 3.0  # standard deviations from the centre to a limit
FEWEST = 8  # values for limits: from fewer the moving range is known to no better than a third
ON_ONE_SIDE = 9  # in a row, once in 256 by chance


@dataclass(frozen=True)
class ControlChart:
    """Centre line and limits from the values of a baseline, and the indices of the values that speak for a change."""

    centre: float
    low: float
    high: float
    baseline: int  # number of values, from the first on, that centre and limits rest on
    beyond: tuple[int, ...]  # indices of the values outside the limits
    shifted: tuple[int, ...]  # indices at which a row of nine on one side of the centre is complete

    @property
    def changed(self) -> bool:
        """Whether any value lies outside the limits or completes a row on one side."""
        return bool(self.beyond or self.shifted)

    def as_json(self) -> dict[str, Any]:
        """Return the chart as a JSON object."""
        return {
            "centre": self.centre,
            "low": self.low,
            "high": self.high,
            "baseline": self.baseline,
            "beyond": list(self.beyond),
            "shifted": list(self.shifted),
            "changed": self.changed,
        }


def control_chart(values: Array, baseline: int | None = None) -> ControlChart | None:
    """Compute centre and limits of values in the order of time; None where the baseline has fewer than eight values.

    Parameters
    ----------
    values : (n,), finite.
    baseline : how many of the first ones the limits rest on; by default all.
    """
    count = len(values) if baseline is None else min(baseline, len(values))
    if count < FEWEST:
        return None
    first = values[:count]
    centre = float(np.mean(first))
    half_width = WIDTH * float(np.mean(np.abs(np.diff(first)))) / RANGES_TO_SIGMA
    beyond = np.flatnonzero(np.abs(values - centre) > half_width)
    sides = np.sign(values - centre)
    shifted = [
        index
        for index in range(ON_ONE_SIDE - 1, len(values))
        if abs(float(np.sum(sides[index - ON_ONE_SIDE + 1 : index + 1]))) == ON_ONE_SIDE
    ]
    return ControlChart(centre, centre - half_width, centre + half_width, count, tuple(beyond.tolist()), tuple(shifted))
