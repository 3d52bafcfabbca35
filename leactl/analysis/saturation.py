"""Whether a sensor was at the end of its range: its readings pile up at the highest or lowest value of the record."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from leactl.analysis.levels import Hold, span
from leactl.runfile.reader import Channel

Array = npt.NDArray[np.float64]

SHARE = 0.05  # of a hold's readings at the extreme
FEWEST = 5  # readings there
PILE = 3  # times as many there as at the next value; the tail of noise has fewer
NOISY = 5  # distinct values in most holds: less, and the resolution hides what a pile would show


def saturated(channel: Channel, holds: Sequence[Hold]) -> tuple[float, list[Hold]]:
    """The value that the channel stops at and the holds that reach it; no holds where it never does.

    Where noise shows, one hold with a pile at the extreme is enough. Without it a level that is exactly constant looks
    the same as an end of range, and only two levels of current at one extreme tell.
    """
    parts = [(hold, settled_values(channel, hold)) for hold in holds]
    parts = [(hold, values) for hold, values in parts if len(values)]
    if not parts:
        return float("nan"), []
    noisy = float(np.median([len(np.unique(values)) for _, values in parts])) >= NOISY
    every = np.concatenate([values for _, values in parts])
    for extreme in (float(every.max()), float(every.min())):
        reached = [hold for hold, values in parts if piles_up(values, extreme)]
        if reached and (noisy or len({hold.setpoint for hold in reached}) > 1):
            return extreme, reached
    return float("nan"), []


def settled_values(channel: Channel, hold: Hold) -> Array:
    """Readings in the settled part of a hold, without missed ones."""
    values = channel.values[span(channel, hold.start, hold.stop)]
    return values[np.isfinite(values)]


def piles_up(values: Array, extreme: float) -> bool:
    """Whether a hold's readings gather at this value as a range's end makes them."""
    there = values == extreme
    if there.sum() < max(FEWEST, SHARE * len(values)):
        return False
    rest = values[~there]
    if not len(rest):
        return True
    nearest = rest[np.argmin(np.abs(rest - extreme))]
    return int(there.sum()) >= PILE * int(np.sum(rest == nearest))
