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
from leactl.runfile.reader import Channel

NOISY = 0.4  # share of readings equal to the one before, above which the resolution, 1.5 times the noise, hides it
IMPROBABLE = 1e-9  # that noise alone makes so long a row of equal readings
FEWEST = 5  # readings in such a row


def mask_repeats(channel: Channel, holds: Sequence[Hold]) -> tuple[Channel, int]:
    """The channel with readings that came again as missed, and how many those are in the holds' settled parts."""
    parts = [span(channel, hold.start, hold.stop) for hold in holds]
    seen = [channel.values[part][np.isfinite(channel.values[part])] for part in parts]
    shares = [float(np.mean(values[1:] == values[:-1])) for values in seen if len(values) > 1]
    share = float(np.median(shares)) if shares else 1.0
    if share > NOISY and noise_shows(channel.values, staying=False):  # it may hang in most of the record
        share = float(np.mean(rows(channel.values)[1] > 1))
    if share > NOISY:
        return channel, 0
    longest = max(FEWEST, math.ceil(math.log(IMPROBABLE) / math.log(share))) if share > 0.0 else FEWEST
    again = repeats(channel.values, longest)
    if channel.quantity != "torque":  # a shaft that stands and a drive that is off read nothing again and again
        again &= channel.values != 0.0
    count = sum(int(again[part].sum()) for part in parts)
    return replace(channel, values=np.where(again, np.nan, channel.values)), count


def repeats(values: npt.NDArray[np.float64], longest: int) -> npt.NDArray[np.bool_]:
    """Every reading but the first of each row of equal ones that has `longest` or more."""
    new, lengths = rows(values)
    return np.asarray(~new & np.repeat(lengths >= longest, lengths))


def rows(values: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
    """Which readings differ from the one before, and the lengths of the rows of equal ones."""
    new = np.concatenate([[True], values[1:] != values[:-1]])
    return new, np.diff(np.append(np.flatnonzero(new), len(values)))
