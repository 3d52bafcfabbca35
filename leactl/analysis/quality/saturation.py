"""Saturated sensors: readings pile up at the highest or lowest value of the record, the end of the range."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from leactl.analysis.signals.levels import Hold, samples_between
from leactl.runfile.read.reader import Channel

Array = npt.NDArray[np.float64]

TORQUE = "torque"
SHARE = 0.05  # of a hold's readings: least share at the extreme in a pile
FEWEST = 5  # readings in a pile
PILE = 3  # least ratio of readings at the extreme to those at the next value; the tail of noise has fewer
CHANCE = 1e-3  # largest probability of a pile by chance
MANY = 40  # readings at the two outermost values, above which a pile is not by chance
ALIKE = 0.5  # distinct values over readings, without those at the extreme: with more, a pile is an end of range
NOISY = 5  # distinct values in most holds: with fewer, the resolution may hide the noise
FLICKERS = 0.4  # share of turning points above which a record shows noise; in white noise two thirds are turning points
BEYOND = 0.1  # least share of turns larger than the smallest step; if noise is two thirds of that step, it is one half
RECORD = 50  # readings: a shorter record does not show noise
ONE_WAY = 0.05  # share of turning points; with fewer, a hold approaches its level without noise


def saturated(channel: Channel, holds: Sequence[Hold]) -> tuple[float, list[Hold]]:
    """Return the value at which a channel saturates and the holds that reach it; no holds if it does not saturate.

    Where noise shows, one hold with a pile of readings at the extreme is enough. Without noise a constant level looks
    like an end of range, and only two different setpoints at one extreme are evidence.
    """
    values_by_hold = [(hold, settled_values(channel, hold)) for hold in holds]
    values_by_hold = [(hold, values) for hold, values in values_by_hold if len(values)]
    if not values_by_hold:
        return float("nan"), []
    all_values = np.concatenate([values for _, values in values_by_hold])
    for extreme in (float(all_values.max()), float(all_values.min())):
        if extreme == 0.0 and channel.quantity != TORQUE:  # a shaft that stands, or a drive that is off
            continue
        at_extreme = [
            hold for hold, values in values_by_hold if piles_up(values, extreme) and not by_chance(values, extreme)
        ]
        if not at_extreme:
            continue
        distinct_counts = [
            (0 if one_way(values) else len(np.unique(values)), hold in at_extreme) for hold, values in values_by_hold
        ]
        count_sets = [count for count, _ in distinct_counts], [count for count, piled in distinct_counts if not piled]
        noisy = any(np.median(counts) >= NOISY for counts in count_sets if counts) or noise_shows(channel.values)
        if noisy or len({hold.setpoint for hold in at_extreme}) > 1:
            return extreme, at_extreme
    return float("nan"), []


def noise_shows(values: Array, staying: bool = True) -> bool:
    """Return whether readings between the extremes go up and down as noise does and transients do not.

    With `staying`, repeated readings count as readings without a turn. Without it, they are left out, and turns must be
    larger than one step of the resolution: a level midway between two readings alternates between them.
    """
    finite = values[np.isfinite(values)]
    steps = np.diff(finite[(finite != finite.max()) & (finite != finite.min())]) if len(finite) else finite
    step_products = steps[1:] * steps[:-1]
    if not staying:
        changes = step_products != 0.0
        turn_sizes = np.maximum(np.abs(steps[1:]), np.abs(steps[:-1]))[changes & (step_products < 0.0)]
        step_products = step_products[changes]
        smallest_step = float(np.min(np.abs(steps[steps != 0.0]), initial=np.inf))
        if not len(turn_sizes) or float(np.mean(turn_sizes > 1.5 * smallest_step)) < BEYOND:
            return False
    return len(step_products) >= RECORD and float(np.mean(step_products < 0.0)) > FLICKERS


def one_way(values: Array) -> bool:
    """Return whether readings hardly ever change direction, as in a simulation without noise that settles."""
    steps = np.diff(values)
    steps = steps[steps != 0.0]
    return float(np.mean(steps[1:] * steps[:-1] < 0.0)) < ONE_WAY if len(steps) > 1 else False


def settled_values(channel: Channel, hold: Hold) -> Array:
    """Return the finite readings in the settled part of a hold."""
    values = channel.values[samples_between(channel, hold.start, hold.stop)]
    return values[np.isfinite(values)]


def clipped(channel: Channel) -> float | None:
    """Return the value at which a record is clipped; None if it is not clipped, or shows no noise to judge it by."""
    finite = channel.values[np.isfinite(channel.values)]
    if not len(finite) or not noise_shows(channel.values):
        return None
    extremes = (float(finite.max()), float(finite.min()))
    return next((extreme for extreme in extremes if extreme != 0.0 and piles_up(finite, extreme)), None)


def piles_up(values: Array, extreme: float, share: float = SHARE) -> bool:
    """Return whether a hold's readings accumulate at `extreme` as at the end of a range.

    `share` is the least share of readings at the extreme.
    """
    at_extreme = values == extreme
    if at_extreme.sum() < max(FEWEST, share * len(values)):
        return False
    inner_values = values[~at_extreme]
    if not len(inner_values):
        return True
    nearest = inner_values[np.argmin(np.abs(inner_values - extreme))]
    return int(at_extreme.sum()) >= PILE * int(np.sum(inner_values == nearest))


def by_chance(values: Array, extreme: float) -> bool:
    """Return whether a coarse resolution alone explains the readings at the extreme.

    It does if readings that fall on the extreme or on the next value with equal probability make such a pile with more
    than the probability `CHANCE`.
    """
    pile_size, inner_values = int(np.sum(values == extreme)), values[values != extreme]
    distances = np.sort(np.abs(inner_values - extreme))
    tosses = pile_size + int(np.sum(distances == distances[0])) if len(distances) else pile_size
    if tosses > MANY or len(np.unique(inner_values)) > ALIKE * len(inner_values):
        return False
    return sum(math.comb(tosses, count) for count in range(pile_size, tosses + 1)) / 2.0**tosses > CHANCE
