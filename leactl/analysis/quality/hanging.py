"""Find where a channel repeats one reading although noise, or what it should follow, moves it.

Nothing here knows a unit or a rate: readings are compared with each other, times counted in readings.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.analysis.quality.repeated_readings import FEWEST_REPEATS, IMPROBABLE, MOST_EQUAL_SHARE, rows
from leactl.analysis.quality.saturation import noise_shows

Array = npt.NDArray[np.float64]

LASTING = 0.05  # of a record's readings: shorter rows are missed readings, which the analyses leave out
STEPPED = 0.5  # of the whole span of what a channel follows, that this moves while the channel stands
BOTH_SIDES = 5  # readings on each side of such a move: the first ones after a move may come late


class RepeatedReading(NamedTuple):
    """The longest row of equal readings in a record, by the indices of its first and last reading."""

    first: int
    last: int
    value: float

    @property
    def length(self) -> int:
        """Number of readings in the row."""
        return self.last - self.first + 1


def longest_repeat(values: Array) -> RepeatedReading | None:
    """Return the longest row of equal readings; None where no two in a row are equal."""
    is_new, lengths = rows(values)
    starts = np.flatnonzero(is_new)
    finite_lengths = np.where(np.isfinite(values[starts]), lengths, 0)
    if not len(finite_lengths) or finite_lengths.max() < 2:
        return None
    longest = int(np.argmax(finite_lengths))
    return RepeatedReading(
        int(starts[longest]), int(starts[longest] + lengths[longest] - 1), float(values[starts[longest]])
    )


def hangs(values: Array, repeat: RepeatedReading) -> bool:
    """Whether a row of equal readings is longer than the noise of the other readings would leave by chance."""
    if repeat.length < max(FEWEST_REPEATS, LASTING * len(values)):
        return False
    others = np.delete(values, slice(repeat.first, repeat.last + 1))
    others = others[np.isfinite(others)]
    if len(others) < FEWEST_REPEATS or not noise_shows(others, staying=False):
        return False
    share = float(np.mean(np.diff(others) == 0.0))
    return share <= MOST_EQUAL_SHARE and (
        share == 0.0 or repeat.length >= math.ceil(math.log(IMPROBABLE) / math.log(share))
    )


def stands_while_other_moves(repeat: RepeatedReading, other: Array) -> bool:
    """Whether `other`, which the channel follows, changes level during the row of equal readings."""
    finite = other[np.isfinite(other)]
    within = other[repeat.first : repeat.last + 1]
    within = within[np.isfinite(within)]
    if len(within) < 2 * BOTH_SIDES:
        return False
    sorted_values = np.sort(within)
    return bool(sorted_values[-BOTH_SIDES] - sorted_values[BOTH_SIDES - 1] > STEPPED * float(np.ptp(finite)) > 0.0)
