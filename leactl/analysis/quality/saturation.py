"""Saturated sensors: readings pile up at the highest or lowest value of the record, the end of the range."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from leactl.analysis.signals.levels import Hold, samples_between
from leactl.runfile.read.reader import Channel

Array = npt.NDArray[np.float64]

TORQUE = "torque"
LEAST_PILE_SHARE = 0.05  # of a hold's readings; fewer at the extreme are no pile
FEWEST_PILED_READINGS = 5  # fewer at the extreme are no pile
LEAST_PILE_RATIO = 3  # readings at the extreme over those at the next value; the tail of noise has fewer
CHANCE_PROBABILITY = 1e-3  # a pile that a coarse resolution makes with a higher probability may be chance
MOST_TOSSES = 40  # readings at the two outermost values; with more, a pile is not by chance
MOST_DISTINCT_SHARE = 0.5  # distinct values over readings inside the extreme; with more, a pile is not by chance
FEWEST_DISTINCT_VALUES = 5  # in most holds; with fewer, the resolution may hide the noise
LEAST_TURNING_SHARE = 0.4  # turning points over readings of a noisy record; white noise has two thirds
LEAST_LARGE_TURNS = 0.1  # share of turns above the smallest step; it is one half if noise is two thirds of that step
FEWEST_STEPS = 50  # from reading to reading; a shorter record does not show noise
MOST_ONE_WAY_TURNS = 0.05  # share of turning points in a hold that approaches its level without noise


def find_saturation(channel: Channel, holds: Sequence[Hold]) -> tuple[float, list[Hold]]:
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
        # the zero of a shaft at rest or of a drive that is off is no end of a range
        if extreme == 0.0 and channel.quantity != TORQUE:
            continue
        holds_at_extreme = [
            hold for hold, values in values_by_hold if piles_up(values, extreme) and not may_be_chance(values, extreme)
        ]
        if not holds_at_extreme:
            continue
        distinct_counts = [
            (0 if goes_one_way(values) else len(np.unique(values)), hold in holds_at_extreme)
            for hold, values in values_by_hold
        ]
        count_sets = (
            [count for count, _ in distinct_counts],
            [count for count, is_at_extreme in distinct_counts if not is_at_extreme],
        )
        is_noisy = any(np.median(counts) >= FEWEST_DISTINCT_VALUES for counts in count_sets if counts) or noise_shows(
            channel.values
        )
        if is_noisy or len({hold.setpoint for hold in holds_at_extreme}) > 1:
            return extreme, holds_at_extreme
    return float("nan"), []


def noise_shows(values: Array, count_repeats: bool = True) -> bool:
    """Return whether readings between the extremes go up and down as noise does and transients do not.

    With `count_repeats`, repeated readings count as readings without a turn. Without it, they are left out, and a share
    `LEAST_LARGE_TURNS` of the turns must be larger than one step of the resolution: a level midway between two readings
    alternates between them.
    """
    finite = values[np.isfinite(values)]
    steps = np.diff(finite[(finite != finite.max()) & (finite != finite.min())]) if len(finite) else finite
    step_products = steps[1:] * steps[:-1]
    if not count_repeats:
        is_change = step_products != 0.0
        turn_sizes = np.maximum(np.abs(steps[1:]), np.abs(steps[:-1]))[is_change & (step_products < 0.0)]
        step_products = step_products[is_change]
        smallest_step = float(np.min(np.abs(steps[steps != 0.0]), initial=np.inf))
        if not len(turn_sizes) or float(np.mean(turn_sizes > 1.5 * smallest_step)) < LEAST_LARGE_TURNS:
            return False
    return len(step_products) >= FEWEST_STEPS and float(np.mean(step_products < 0.0)) > LEAST_TURNING_SHARE


def goes_one_way(values: Array) -> bool:
    """Return whether readings hardly ever change direction, as in a simulation without noise that settles."""
    steps = np.diff(values)
    steps = steps[steps != 0.0]
    return float(np.mean(steps[1:] * steps[:-1] < 0.0)) < MOST_ONE_WAY_TURNS if len(steps) > 1 else False


def settled_values(channel: Channel, hold: Hold) -> Array:
    """Return the finite readings in the settled part of a hold."""
    values = channel.values[samples_between(channel, hold.start, hold.stop)]
    return values[np.isfinite(values)]


def clipping_value(channel: Channel) -> float | None:
    """Return the value at which a record is clipped; None if it is not clipped, or has no noise that shows clipping."""
    finite = channel.values[np.isfinite(channel.values)]
    if not len(finite) or not noise_shows(channel.values):
        return None
    extremes = (float(finite.max()), float(finite.min()))
    return next((extreme for extreme in extremes if extreme != 0.0 and piles_up(finite, extreme)), None)


def piles_up(values: Array, extreme: float, share: float = LEAST_PILE_SHARE) -> bool:
    """Return whether a hold's readings accumulate at `extreme` as at the end of a range.

    `share` is the least share of readings at the extreme.
    """
    at_extreme = values == extreme
    if at_extreme.sum() < max(FEWEST_PILED_READINGS, share * len(values)):
        return False
    inner_values = values[~at_extreme]
    if not len(inner_values):
        return True
    next_value = inner_values[np.argmin(np.abs(inner_values - extreme))]
    return int(at_extreme.sum()) >= LEAST_PILE_RATIO * int(np.sum(inner_values == next_value))


def may_be_chance(values: Array, extreme: float) -> bool:
    """Return whether a coarse resolution alone explains the readings at the extreme.

    It does if readings that fall on the extreme or on the next value with equal probability make such a pile with more
    than the probability `CHANCE_PROBABILITY`.
    """
    pile_size, inner_values = int(np.sum(values == extreme)), values[values != extreme]
    distances = np.sort(np.abs(inner_values - extreme))
    toss_count = pile_size + int(np.sum(distances == distances[0])) if len(distances) else pile_size
    if toss_count > MOST_TOSSES or len(np.unique(inner_values)) > MOST_DISTINCT_SHARE * len(inner_values):
        return False
    return (
        sum(math.comb(toss_count, count) for count in range(pile_size, toss_count + 1)) / 2.0**toss_count
        > CHANCE_PROBABILITY
    )
