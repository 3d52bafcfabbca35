"""Control chart of one result over many runs: limits of chance, and the values that indicate a change.

Individuals and moving ranges: ISO 7870-2:2013. Nine in a row on one side: Nelson, "The Shewhart control chart: tests
for special causes", Journal of Quality Technology 16 (1984), test 2.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
MOVING_RANGE_OVER_STD = 1.128  # d2 of two values: mean moving range over standard deviation
LIMIT_STDS = 3.0  # standard deviations from the centre to a limit
FEWEST_BASELINE_VALUES = 8  # fewer determine the mean moving range no better than to a third
ROW_LENGTH = 9  # values in a row on one side of the centre: nine have a chance of 1 in 256


@dataclass(frozen=True)
class ControlChart:
    """Centre line and limits from the values of a baseline, and the indices of the values that indicate a change."""

    centre: float
    low: float
    high: float
    baseline: int  # number of first values that centre and limits are computed from
    beyond: tuple[int, ...]  # indices of the values outside the limits
    shifted: tuple[int, ...]  # indices at which a row of nine on one side of the centre is complete

    @property
    def changed(self) -> bool:
        """Return whether any value lies outside the limits or completes a row on one side."""
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
    """Return the chart of a series of values; None if the baseline has fewer than `FEWEST_BASELINE_VALUES`.

    Parameters
    ----------
    values : shape (n,), finite, in the order of time.
    baseline : number of first values that the limits are computed from; by default all.
    """
    count = len(values) if baseline is None else min(baseline, len(values))
    if count < FEWEST_BASELINE_VALUES:
        return None
    baseline_values = values[:count]
    centre = float(np.mean(baseline_values))
    half_width = LIMIT_STDS * float(np.mean(np.abs(np.diff(baseline_values)))) / MOVING_RANGE_OVER_STD
    outside_indices = np.flatnonzero(np.abs(values - centre) > half_width)
    sides = np.sign(values - centre)
    shifted_indices = [
        index
        for index in range(ROW_LENGTH - 1, len(values))
        if abs(float(np.sum(sides[index - ROW_LENGTH + 1 : index + 1]))) == ROW_LENGTH
    ]
    return ControlChart(
        centre, centre - half_width, centre + half_width, count, tuple(outside_indices.tolist()), tuple(shifted_indices)
    )
