"""Means of a residual in bins of one variable, with intervals, times the sign that an effect follows.

Bins follow from the data: as many as Rice's rule gives for independent samples, with edges at quantiles of the samples
and of the effect's power, so that bins are fine where the effect acts.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy import stats

from leactl.gap.diagnosis import Cause

Array = npt.NDArray[np.float64]
Groups = npt.NDArray[np.intp]
View = TypeVar("View")
ORDER_PARAMETER = "order"  # name of the parameter that says how often an effect repeats in a turn
MOST_BINS = 24  # bins that a drawing can show
FEWEST_BINS = 12  # bins that show a wave
FEWEST_BIN_SAMPLES = 8  # samples of a bin; a bin with fewer has no mean
LEAST_FOLLOWED_SHARE = 0.5  # share of an effect's part that a variable must explain for the effect to follow it
DRAWN_POWER_SHARE = 0.99  # share of an effect's power in the range that the bins span, before the range is widened
MEAN_CONFIDENCE = 0.95  # two-sided confidence of a bin's mean
EQUAL_SHARE = 0.9  # share of what the best explanation explains, from which a simpler one is preferred


@dataclass(frozen=True, eq=False)
class Means:
    """Mean in each bin with its interval; NaN where a bin has too few samples, the interval also for one stretch."""

    mean: Array
    low: Array  # ends of the interval
    high: Array

    def rms(self, counts: Groups) -> float:
        """Return the root mean square of the means, weighted by their numbers of samples."""
        has_mean = np.isfinite(self.mean)
        return float(
            np.sqrt(np.sum(counts[has_mean] * self.mean[has_mean] ** 2) / max(float(counts[has_mean].sum()), 1.0))
        )

    @property
    def off_zero(self) -> int:
        """Number of intervals that do not contain zero."""
        return int(np.sum((self.low > 0.0) | (self.high < 0.0)))


@dataclass(frozen=True)
class FollowedSign:
    """Sign that a residual is multiplied by, and the share of an effect's part that then follows the variable."""

    name: str  # variable whose sign it is; empty for no sign
    explained: float


def bin_count(independent_samples: float) -> int:
    """Return the number of bins for a number of independent samples, by Rice's rule within limits."""
    return int(np.clip(2.0 * independent_samples ** (1.0 / 3.0), FEWEST_BINS, MOST_BINS))


def bin_edges(values: Array, effect_part: Array, count: int) -> Array:
    """Return bin edges at quantiles, half by samples and half by the power of an effect's part.

    A variable with few levels has edges between its levels. The bins span the range in which the effect acts, and its
    width once more on either side.
    """
    levels = np.unique(values)
    if len(levels) <= count:
        midpoints = 0.5 * (levels[1:] + levels[:-1])
        half_width = 0.25 * float(np.min(np.diff(levels))) if len(levels) > 1 else 0.5
        return np.concatenate([levels[:1] - half_width, midpoints, levels[-1:] + half_width])
    order = np.argsort(values, kind="stable")
    ordered, power = values[order], np.cumsum(effect_part[order] ** 2)
    total = float(power[-1])
    cumulative_share = power / total if total > 0.0 else np.arange(1, len(order) + 1) / len(order)
    lowest, highest = (
        float(ordered[np.searchsorted(cumulative_share, q)])
        for q in (0.5 * (1.0 - DRAWN_POWER_SHARE), 0.5 * (1.0 + DRAWN_POWER_SHARE))
    )
    is_inside = (ordered >= lowest - (highest - lowest)) & (ordered <= highest + (highest - lowest))
    drawn_values, weight = ordered[is_inside], np.diff(cumulative_share, prepend=0.0)[is_inside]
    cumulative_weight = np.cumsum(weight / max(float(weight.sum()), 1e-300) + 1.0 / len(drawn_values))
    wanted_cuts = np.searchsorted(cumulative_weight, np.arange(1, count) / count * cumulative_weight[-1])
    cuts = [0]
    for cut in wanted_cuts.tolist():
        if cut - cuts[-1] >= FEWEST_BIN_SAMPLES and len(drawn_values) - cut >= FEWEST_BIN_SAMPLES:
            cuts.append(cut)
    return np.unique(np.concatenate([drawn_values[cuts], drawn_values[-1:]]))


def bin_of(values: Array, edges: Array) -> Groups:
    """Return the bin of each value, -1 for a value outside all bins."""
    bins = np.searchsorted(edges, values, side="right") - 1
    bins[values == edges[-1]] = len(edges) - 2
    return np.where((values < edges[0]) | (values > edges[-1]), -1, bins)


def explained_share(effect_part: Array, bins: Groups) -> float:
    """Return the share of an effect's power that its bin means explain; bins with few samples explain nothing."""
    is_inside = bins >= 0
    counts = np.bincount(bins[is_inside])
    sums = np.bincount(bins[is_inside], weights=effect_part[is_inside])
    total = float(np.sum(effect_part**2))
    has_enough = counts >= FEWEST_BIN_SAMPLES
    return float(np.sum(sums[has_enough] ** 2 / counts[has_enough])) / total if total > 0.0 else 0.0


def best_sign(effect_part: Array, bins: Groups, signs: Mapping[str, Array]) -> FollowedSign:
    """Return the sign along which an effect's part follows a variable best; no sign where that does nearly as well.

    effect_part : part of the residual that the effect explains, by row.
    signs : by variable, the sign of each row.
    """
    trials = [FollowedSign("", explained_share(effect_part, bins))]
    trials += [FollowedSign(name, explained_share(effect_part * sign, bins)) for name, sign in signs.items()]
    best_share = max(trial.explained for trial in trials)
    return next(trial for trial in trials if trial.explained >= EQUAL_SHARE * best_share)


def means(values: Array, bin_of_row: Groups, groups: Groups, bins: int) -> Means:
    """Return the means in bins, with intervals that count a stretch once, however many rows it has (cluster-robust).

    groups : stretch of each row.
    bins : number of bins.
    """
    mean, half_width = np.full(bins, np.nan), np.full(bins, np.nan)
    for index in range(bins):
        is_inside = bin_of_row == index
        count = int(is_inside.sum())
        if count < FEWEST_BIN_SAMPLES:
            continue
        mean[index] = float(values[is_inside].mean())
        _, group_index = np.unique(groups[is_inside], return_inverse=True)
        sums = np.bincount(group_index, weights=values[is_inside] - mean[index])
        if len(sums) > 1:
            standard_error = np.sqrt(len(sums) / (len(sums) - 1) * float(sums @ sums)) / count
            half_width[index] = standard_error * float(stats.t.ppf(0.5 * (1.0 + MEAN_CONFIDENCE), len(sums) - 1))
    return Means(mean, mean - half_width, mean + half_width)


def fold_angle(angle: Array, periods: float) -> Array:
    """Return an angle [rad] folded into one of the `periods` periods in a turn."""
    period = 2.0 * np.pi / periods
    return np.asarray(np.mod(angle, period), np.float64)


def repeats(angle: Array, periods: float, explained: Callable[[Array], float]) -> bool:
    """Return whether an effect's part follows the folded angle as well as the angle; False for less than one period.

    explained : returns the share of the part that its means over a variable explain.
    """
    if np.ptp(angle) <= 2.0 * np.pi / periods:
        return False
    return explained(fold_angle(angle, periods)) >= EQUAL_SHARE * explained(angle)


def periods_of(cause: Cause) -> float:
    """Return the number of periods of an effect in a turn; 1 for an effect without an order."""
    return next((item.value for item in cause.parameters if item.name == ORDER_PARAMETER), 1.0)


def last_reversal(speed: Array) -> Groups:
    """Return for each sample the index at which the sign of the speed last changed; 0 before the first change."""
    reversals = np.flatnonzero(np.diff(np.sign(speed), prepend=np.sign(speed[0])) != 0)
    last_index = np.zeros(len(speed), np.intp)
    last_index[reversals] = reversals
    return np.asarray(np.maximum.accumulate(last_index), np.intp)


def first_that_follows(views: Sequence[View], explained: Callable[[View], float]) -> View | None:
    """Return the first view that explains enough of an effect's part, else the one that explains most."""
    following = [view for view in views if explained(view) >= LEAST_FOLLOWED_SHARE]
    return next(iter(following), None) or max(views, key=explained, default=None)
