"""Channels that hang: one reading repeats although noise, or the quantity that the channel follows, should change it.

No threshold has a unit or depends on a rate: readings are compared with each other, and times are counted in readings.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.analysis.quality.repeated_readings import FEWEST_REPEATS, MOST_EQUAL_SHARE, MOST_REPEAT_PROBABILITY, rows
from leactl.analysis.quality.saturation import noise_shows

Array = npt.NDArray[np.float64]

LEAST_HANGING_SHARE = 0.05  # of a record's readings; shorter rows are missed readings, which the analyses leave out
# smallest change of the companion that the channel must follow, as a share of the companion's range
LEAST_COMPANION_CHANGE = 0.5
FEWEST_ON_EACH_SIDE = 5  # readings on each side of such a change; the first readings after it may come late


class RepeatedReading(NamedTuple):
    """A row of equal readings in a record, by the indices of its first and last reading."""

    first: int
    last: int
    value: float

    @property
    def length(self) -> int:
        """Return the number of readings in the row."""
        return self.last - self.first + 1


def longest_repeat(values: Array) -> RepeatedReading | None:
    """Return the longest row of equal readings; None if no two successive readings are equal."""
    if not len(values):
        return None
    is_new, lengths = rows(values)
    starts = np.flatnonzero(is_new)
    finite_lengths = np.where(np.isfinite(values[starts]), lengths, 0)
    if finite_lengths.max() < 2:
        return None
    longest = int(np.argmax(finite_lengths))
    return RepeatedReading(
        int(starts[longest]), int(starts[longest] + lengths[longest] - 1), float(values[starts[longest]])
    )


def hangs(values: Array, repeat: RepeatedReading) -> bool:
    """Return whether a row of equal readings is a considerable share of the record and too long to be chance.

    The noise of the other readings shows what may be chance.
    """
    if repeat.length < max(FEWEST_REPEATS, LEAST_HANGING_SHARE * len(values)):
        return False
    outside_row = np.delete(values, slice(repeat.first, repeat.last + 1))
    outside_row = outside_row[np.isfinite(outside_row)]
    if len(outside_row) < FEWEST_REPEATS or not noise_shows(outside_row, count_repeats=False):
        return False
    equal_share = float(np.mean(np.diff(outside_row) == 0.0))
    # by noise alone, a row of n readings has the probability equal_share ** n
    return equal_share <= MOST_EQUAL_SHARE and (
        equal_share == 0.0 or repeat.length >= math.ceil(math.log(MOST_REPEAT_PROBABILITY) / math.log(equal_share))
    )


def stands_while_companion_moves(repeat: RepeatedReading, companion: Array) -> bool:
    """Return whether the quantity that a channel follows changes level during a row of equal readings.

    `companion` is that quantity at the stamps of the channel.
    """
    finite = companion[np.isfinite(companion)]
    within = companion[repeat.first : repeat.last + 1]
    within = within[np.isfinite(within)]
    if len(within) < 2 * FEWEST_ON_EACH_SIDE:
        return False
    sorted_values = np.sort(within)
    return bool(
        sorted_values[-FEWEST_ON_EACH_SIDE] - sorted_values[FEWEST_ON_EACH_SIDE - 1]
        > LEAST_COMPANION_CHANGE * float(np.ptp(finite))
        > 0.0
    )
