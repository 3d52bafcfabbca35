"""Find where a channel repeats one reading although noise, or what it should follow, moves it.

Nothing here knows a unit or a rate: readings are compared with each other, times counted in readings.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.analysis.quality.repeated_readings import FEWEST, IMPROBABLE, NOISY, rows
from leactl.analysis.quality.saturation import noise_shows

Array = npt.NDArray[np.float64]

LASTING = 0.05  # of a record's readings: shorter rows are missed readings, which the analyses leave out
STEPPED = 0.5  # of the whole span of what a channel follows, that this moves while the channel stands
BOTH_SIDES = 5  # readings on each side of such a move: the first ones after a move may come late


class RepeatedReading(NamedTuple):
    """The longest row of equal readings."""

    first: int
    last: int
    value: float

    @property
    def length(self) -> int:
        """How many readings it has."""
        return self.last - self.first + 1


def longest_repeat(values: Array) -> RepeatedReading | None:
    """The longest row of equal numbers; None of a record without two."""
    new, lengths = rows(values)
    starts = np.flatnonzero(new)
    numbers = np.where(np.isfinite(values[starts]), lengths, 0)
    if not len(numbers) or numbers.max() < 2:
        return None
    at = int(np.argmax(numbers))
    return RepeatedReading(int(starts[at]), int(starts[at] + lengths[at] - 1), float(values[starts[at]]))


def hangs(values: Array, row: RepeatedReading) -> bool:
    """Whether a row is longer than the noise of the other readings lets it be by chance."""
    if row.length < max(FEWEST, LASTING * len(values)):
        return False
    others = np.delete(values, slice(row.first, row.last + 1))
    others = others[np.isfinite(others)]
    if len(others) < FEWEST or not noise_shows(others, staying=False):
        return False
    share = float(np.mean(np.diff(others) == 0.0))
    return share <= NOISY and (share == 0.0 or row.length >= math.ceil(math.log(IMPROBABLE) / math.log(share)))


def stands_while_other_moves(row: RepeatedReading, other: Array) -> bool:
    """Whether `other`, which the channel follows, moves far and stays there for readings within the row."""
    seen = other[np.isfinite(other)]
    within = other[row.first : row.last + 1]
    within = within[np.isfinite(within)]
    if len(within) < 2 * BOTH_SIDES:
        return False
    ends = np.sort(within)
    return bool(ends[-BOTH_SIDES] - ends[BOTH_SIDES - 1] > STEPPED * float(np.ptp(seen)) > 0.0)
