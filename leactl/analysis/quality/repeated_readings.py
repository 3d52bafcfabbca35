"""Readings that came again in place of new ones: a sensor that hangs, or a reader that was not answered.

The run file's rule is NaN for a missed sample; a file made elsewhere may not keep it, and a value that stands while the
level moves on drags the mean along. Only a channel with noise can tell: what it reads is hardly ever the same twice.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from leactl.analysis.quality.saturation import noise_shows
from leactl.analysis.signals.levels import Hold, span
from leactl.runfile.read.reader import Channel

MOST_EQUAL_SHARE = 0.4  # of readings equal to the one before; above it the resolution, over 1.5 noise, hides repeats
IMPROBABLE = 1e-9  # probability that noise alone makes a row of equal readings this long
FEWEST_REPEATS = 5  # equal readings in such a row


def mask_repeats(channel: Channel, holds: Sequence[Hold]) -> tuple[Channel, int]:
    """Replace repeated readings by NaN, and count those within the settled parts of the holds.

    A channel whose resolution hides its noise is returned unchanged.
    """
    parts = [span(channel, hold.start, hold.stop) for hold in holds]
    settled = [channel.values[part][np.isfinite(channel.values[part])] for part in parts]
    shares = [float(np.mean(values[1:] == values[:-1])) for values in settled if len(values) > 1]
    share = float(np.median(shares)) if shares else 1.0
    if share > MOST_EQUAL_SHARE and noise_shows(channel.values, staying=False):  # it may hang in most of the record
        share = float(np.mean(rows(channel.values)[1] > 1))
    if share > MOST_EQUAL_SHARE:
        return channel, 0
    shortest_row = (
        max(FEWEST_REPEATS, math.ceil(math.log(IMPROBABLE) / math.log(share))) if share > 0.0 else FEWEST_REPEATS
    )
    repeated = repeats(channel.values, shortest_row)
    if channel.quantity != "torque":  # a shaft that stands and a drive that is off read nothing again and again
        repeated &= channel.values != 0.0
    count = sum(int(repeated[part].sum()) for part in parts)
    return replace(channel, values=np.where(repeated, np.nan, channel.values)), count


def repeats(values: npt.NDArray[np.float64], shortest_row: int) -> npt.NDArray[np.bool_]:
    """Mark every reading but the first of each row of `shortest_row` equal readings or more, shape (readings,)."""
    is_new, lengths = rows(values)
    return np.asarray(~is_new & np.repeat(lengths >= shortest_row, lengths))


def rows(values: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
    """Mark readings that differ from the one before, shape (readings,), and return the lengths of the rows between."""
    is_new = np.concatenate([[True], values[1:] != values[:-1]])
    return is_new, np.diff(np.append(np.flatnonzero(is_new), len(values)))
