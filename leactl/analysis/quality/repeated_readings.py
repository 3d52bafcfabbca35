"""Readings that repeat an old value in place of a new one: a sensor that hangs, or a reader without an answer.

A run file has NaN for a missed sample, but a file of another program may repeat the last value instead, which falsifies
a mean after the level has changed. Only a channel with noise shows repeats: its successive readings are hardly ever
equal.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from leactl.analysis.quality.saturation import noise_shows
from leactl.analysis.signals.levels import Hold, samples_between
from leactl.runfile.read.reader import Channel

# share of readings equal to the one before; above it, the resolution is over 1.5 times the noise and hides repeats
MOST_EQUAL_SHARE = 0.4
MOST_REPEAT_PROBABILITY = 1e-9  # that noise alone makes a row of equal readings; a less probable row is a repeat
FEWEST_REPEATS = 5  # equal readings in a row that counts as a repeat


def mask_repeats(channel: Channel, holds: Sequence[Hold]) -> tuple[Channel, int]:
    """Return a channel with NaN for repeated readings, and their number within the settled parts of the holds.

    A channel whose resolution hides its noise is returned unchanged.
    """
    hold_slices = [samples_between(channel, hold.start, hold.stop) for hold in holds]
    settled = [channel.values[in_hold][np.isfinite(channel.values[in_hold])] for in_hold in hold_slices]
    equal_shares = [float(np.mean(values[1:] == values[:-1])) for values in settled if len(values) > 1]
    equal_share = float(np.median(equal_shares)) if equal_shares else 1.0
    # a channel may hang in most of the holds
    if equal_share > MOST_EQUAL_SHARE and noise_shows(channel.values, count_repeats=False):
        equal_share = float(np.mean(rows(channel.values)[1] > 1))
    if equal_share > MOST_EQUAL_SHARE:
        return channel, 0
    shortest_row = (
        max(FEWEST_REPEATS, math.ceil(math.log(MOST_REPEAT_PROBABILITY) / math.log(equal_share)))
        if equal_share > 0.0
        else FEWEST_REPEATS
    )
    is_repeat = repeats(channel.values, shortest_row)
    if channel.quantity != "torque":  # the zeros of a shaft at rest and of a drive that is off are no repeats
        is_repeat &= channel.values != 0.0
    count = sum(int(is_repeat[in_hold].sum()) for in_hold in hold_slices)
    return replace(channel, values=np.where(is_repeat, np.nan, channel.values)), count


def repeats(values: npt.NDArray[np.float64], shortest_row: int) -> npt.NDArray[np.bool_]:
    """Return the mask of repeats: all readings but the first in each row of `shortest_row` equal ones or more."""
    is_new, lengths = rows(values)
    return np.asarray(~is_new & np.repeat(lengths >= shortest_row, lengths))


def rows(values: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
    """Return the mask of readings that differ from the reading before, shape (readings,), and the lengths of all rows.

    A row is a sequence of equal readings.
    """
    is_new = np.concatenate([[True], values[1:] != values[:-1]])
    return is_new, np.diff(np.append(np.flatnonzero(is_new), len(values)))
