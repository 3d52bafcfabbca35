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
ALIKE = 0.5  # distinct values in a hold's readings below its extreme: with more, equal readings mean an end of range
NOISY = 5  # distinct values in most holds: with fewer, the resolution hides what a pile would show
FLICKERS = 0.4  # share of turning points above which noise shows in a record; of white noise two thirds are
BEYOND = 0.1  # share of turning points by more than the smallest step; where noise is two thirds of that, one in two
RECORD = 50  # readings that a record needs for this
ONE_WAY = 0.05  # share of turning points below which a hold still goes to where it settles, without noise


def saturated(channel: Channel, holds: Sequence[Hold]) -> tuple[float, list[Hold]]:
    """Return the value at which a channel saturates and the holds that reach it; no holds where it does not.

    Where noise shows, one hold with a pile of readings at the extreme is enough. Without noise a constant level looks
    like an end of range, and only two different setpoints at one extreme are evidence.
    """
    parts = [(hold, settled_values(channel, hold)) for hold in holds]
    parts = [(hold, values) for hold, values in parts if len(values)]
    if not parts:
        return float("nan"), []
    all_values = np.concatenate([values for _, values in parts])
    for extreme in (float(all_values.max()), float(all_values.min())):
        if extreme == 0.0 and channel.quantity != TORQUE:  # a shaft that stands, or a drive that is off
            continue
        at_extreme = [hold for hold, values in parts if piles_up(values, extreme) and not by_chance(values, extreme)]
        if not at_extreme:
            continue
        distinct_counts = [
            (0 if one_way(values) else len(np.unique(values)), hold in at_extreme) for hold, values in parts
        ]
        count_sets = [count for count, _ in distinct_counts], [count for count, at_end in distinct_counts if not at_end]
        noisy = any(np.median(counts) >= NOISY for counts in count_sets if counts) or noise_shows(channel.values)
        if noisy or len({hold.setpoint for hold in at_extreme}) > 1:
            return extreme, at_extreme
    return float("nan"), []


def noise_shows(values: Array, staying: bool = True) -> bool:
    """Whether readings between the extremes go up and down as noise does and transients do not.

    `staying` says whether repeated readings count, as they do where a coarse resolution would hide noise. Without them,
    turns must be larger than one step: a level near the middle of two readings alternates between them.
    """
    finite = values[np.isfinite(values)]
    steps = np.diff(finite[(finite != finite.max()) & (finite != finite.min())]) if len(finite) else finite
    step_products = steps[1:] * steps[:-1]
    if not staying:
        moved = step_products != 0.0
        turn_sizes = np.maximum(np.abs(steps[1:]), np.abs(steps[:-1]))[moved & (step_products < 0.0)]
        step_products = step_products[moved]
        smallest_step = float(np.min(np.abs(steps[steps != 0.0]), initial=np.inf))
        if not len(turn_sizes) or float(np.mean(turn_sizes > 1.5 * smallest_step)) < BEYOND:
            return False
    return len(step_products) >= RECORD and float(np.mean(step_products < 0.0)) > FLICKERS


def one_way(values: Array) -> bool:
    """Whether readings hardly ever change direction, as in a simulation without noise that settles."""
    steps = np.diff(values)
    steps = steps[steps != 0.0]
    return float(np.mean(steps[1:] * steps[:-1] < 0.0)) < ONE_WAY if len(steps) > 1 else False


def settled_values(channel: Channel, hold: Hold) -> Array:
    """Return the finite readings in the settled part of a hold."""
    values = channel.values[span(channel, hold.start, hold.stop)]
    return values[np.isfinite(values)]


def clipped(channel: Channel) -> float | None:
    """Return the value at which a record is clipped; None where it is not, or where no noise could show it."""
    finite = channel.values[np.isfinite(channel.values)]
    if not len(finite) or not noise_shows(channel.values):
        return None
    ends = (float(finite.max()), float(finite.min()))
    return next((end for end in ends if end != 0.0 and piles_up(finite, end)), None)


def piles_up(values: Array, extreme: float, share: float = SHARE) -> bool:
    """Whether a hold's readings accumulate at `extreme` as at the end of a range."""
    at_extreme = values == extreme
    if at_extreme.sum() < max(FEWEST, share * len(values)):
        return False
    others = values[~at_extreme]
    if not len(others):
        return True
    nearest = others[np.argmin(np.abs(others - extreme))]
    return int(at_extreme.sum()) >= PILE * int(np.sum(others == nearest))


def by_chance(values: Array, extreme: float) -> bool:
    """Whether a coarse resolution alone explains the readings at the extreme.

    Readings that fall on the extreme or on the next value with equal probability would pile up so at `CHANCE`.
    """
    pile_size, others = int(np.sum(values == extreme)), values[values != extreme]
    distances = np.sort(np.abs(others - extreme))
    tosses = pile_size + int(np.sum(distances == distances[0])) if len(distances) else pile_size
    if tosses > MANY or len(np.unique(others)) > ALIKE * len(others):
        return False
    return sum(math.comb(tosses, k) for k in range(pile_size, tosses + 1)) / 2.0**tosses > CHANCE
