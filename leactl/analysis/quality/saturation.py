"""Whether a sensor was at the end of its range: its readings pile up at the highest or lowest value of the record."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from leactl.analysis.signals.levels import Hold, span
from leactl.runfile.read.reader import Channel

Array = npt.NDArray[np.float64]

TORQUE = "torque"
SHARE = 0.05  # of a hold's readings at the extreme
FEWEST = 5  # readings there
PILE = 3  # times as many there as at the next value; the tail of noise has fewer
CHANCE, MANY = 1e-3, 40  # that so many of few readings pile up without an end of range
ALIKE = 0.5  # distinct values in a hold's readings below its extreme: with more, no two are alike but at an end
NOISY = 5  # distinct values in most holds: less, and the resolution hides what a pile would show
FLICKERS = 0.4  # share of turning points above which noise shows in a record; of white noise two thirds are
BEYOND = 0.1  # share of turning points by more than the smallest step; where noise is two thirds of that, one in two
RECORD = 50  # readings of a record that can tell so
ONE_WAY = 0.05  # share of turning points below which a hold still goes to where it settles, without noise


def saturated(channel: Channel, holds: Sequence[Hold]) -> tuple[float, list[Hold]]:
    """The value that the channel stops at and the holds that reach it; no holds where it never does.

    Where noise shows, one hold with a pile at the extreme is enough. Without it a level that is exactly constant looks
    the same as an end of range, and only two levels of current at one extreme tell.
    """
    parts = [(hold, settled_values(channel, hold)) for hold in holds]
    parts = [(hold, values) for hold, values in parts if len(values)]
    if not parts:
        return float("nan"), []
    every = np.concatenate([values for _, values in parts])
    for extreme in (float(every.max()), float(every.min())):
        if extreme == 0.0 and channel.quantity != TORQUE:  # a shaft that stands, or a drive that is off
            continue
        reached = [hold for hold, values in parts if piles_up(values, extreme) and not by_chance(values, extreme)]
        if not reached:
            continue
        distinct = [(0 if one_way(values) else len(np.unique(values)), hold in reached) for hold, values in parts]
        judges = [count for count, _ in distinct], [count for count, at_end in distinct if not at_end]
        noisy = any(np.median(counts) >= NOISY for counts in judges if counts) or noise_shows(channel.values)
        if noisy or len({hold.setpoint for hold in reached}) > 1:
            return extreme, reached
    return float("nan"), []


def noise_shows(values: Array, staying: bool = True) -> bool:
    """Whether a record's readings, those at its extremes left out, go up and down by turns as no transient does.

    `staying` tells whether readings that stay as they are count, as they do where a coarse resolution would hide noise.
    Without them, turns must go beyond the next reading: a level near the middle of two goes from one to the other.
    """
    seen = values[np.isfinite(values)]
    steps = np.diff(seen[(seen != seen.max()) & (seen != seen.min())]) if len(seen) else seen
    turns = steps[1:] * steps[:-1]
    if not staying:
        moved = turns != 0.0
        largest = np.maximum(np.abs(steps[1:]), np.abs(steps[:-1]))[moved & (turns < 0.0)]
        turns = turns[moved]
        least = float(np.min(np.abs(steps[steps != 0.0]), initial=np.inf))
        if not len(largest) or float(np.mean(largest > 1.5 * least)) < BEYOND:
            return False
    return len(turns) >= RECORD and float(np.mean(turns < 0.0)) > FLICKERS


def one_way(values: Array) -> bool:
    """Whether readings hardly ever turn: those of a model without noise that comes to rest, however close."""
    steps = np.diff(values)
    steps = steps[steps != 0.0]
    return float(np.mean(steps[1:] * steps[:-1] < 0.0)) < ONE_WAY if len(steps) > 1 else False


def settled_values(channel: Channel, hold: Hold) -> Array:
    """Readings in the settled part of a hold, without missed ones."""
    values = channel.values[span(channel, hold.start, hold.stop)]
    return values[np.isfinite(values)]


def clipped(channel: Channel) -> float | None:
    """The value at either end that a whole record stops at; None where it has no such end, or no noise to show it."""
    seen = channel.values[np.isfinite(channel.values)]
    if not len(seen) or not noise_shows(channel.values):
        return None
    ends = (float(seen.max()), float(seen.min()))
    return next((end for end in ends if end != 0.0 and piles_up(seen, end)), None)


def piles_up(values: Array, extreme: float, share: float = SHARE) -> bool:
    """Whether a hold's readings gather at this value as a range's end makes them."""
    there = values == extreme
    if there.sum() < max(FEWEST, share * len(values)):
        return False
    rest = values[~there]
    if not len(rest):
        return True
    nearest = rest[np.argmin(np.abs(rest - extreme))]
    return int(there.sum()) >= PILE * int(np.sum(rest == nearest))


def by_chance(values: Array, extreme: float) -> bool:
    """Whether a few readings, that a coarse resolution makes alike anyway, may gather at their extreme without cause.

    As likely to fall on it as on the next value, so many would at `CHANCE`; the tail of noise has fewer.
    """
    pile, rest = int(np.sum(values == extreme)), values[values != extreme]
    near = np.sort(np.abs(rest - extreme))
    tosses = pile + int(np.sum(near == near[0])) if len(near) else pile
    if tosses > MANY or len(np.unique(rest)) > ALIKE * len(rest):
        return False
    return sum(math.comb(tosses, k) for k in range(pile, tosses + 1)) / 2.0**tosses > CHANCE
