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
ORDER_PARAMETER = "order"  # parameter that says how often an effect repeats in a turn
MOST_BINS = 24  # bins that a drawing can show
FEWEST_BINS = 12  # bins that show a wave
FEWEST_IN_BIN = 8  # samples; a bin with fewer has no mean
LEAST_FOLLOWED_SHARE = 0.5  # share of an effect's part that a variable must explain for the effect to follow it
DRAWN_POWER_SHARE = 0.99  # share of an effect's power in the range that is drawn, before the range is widened
MEAN_CONFIDENCE = 0.95  # two-sided confidence of a bin's mean
EQUAL_SHARE = 0.9  # share of what the best explanation explains, from which a simpler one is preferred


@dataclass(frozen=True, eq=False)
class Means:
    """Mean in each bin with its interval; NaN where a bin has too few independent stretches for one."""

    mean: Array
    low: Array
    high: Array

    def rms(self, counts: Groups) -> float:
        """Return the root mean square of the means, weighted by their numbers of samples."""
        known = np.isfinite(self.mean)
        return float(np.sqrt(np.sum(counts[known] * self.mean[known] ** 2) / max(float(counts[known].sum()), 1.0)))

    @property
    def off_zero(self) -> int:
        """Number of intervals that do not contain zero."""
        return int(np.sum((self.low > 0.0) | (self.high < 0.0)))


@dataclass(frozen=True)
class Along:
    """Sign that a residual is multiplied by, and the share of an effect's part that then follows the variable."""

    name: str  # variable whose sign it is; empty for no sign
    explained: float


def bin_count(independent: float) -> int:
    """Return the number of bins for so many independent samples, by Rice's rule within limits."""
    return int(np.clip(2.0 * independent ** (1.0 / 3.0), FEWEST_BINS, MOST_BINS))


def bin_edges(values: Array, part: Array, count: int) -> Array:
    """Return bin edges at quantiles, half by samples and half by the power of an effect's part.

    A variable with few levels has edges between its levels. The bins span the range in which the effect acts, and its
    width once more on either side.
    """
    levels = np.unique(values)
    if len(levels) <= count:
        midpoints = 0.5 * (levels[1:] + levels[:-1])
        half = 0.25 * float(np.min(np.diff(levels))) if len(levels) > 1 else 0.5
        return np.concatenate([levels[:1] - half, midpoints, levels[-1:] + half])
    order = np.argsort(values, kind="stable")
    ordered, power = values[order], np.cumsum(part[order] ** 2)
    total = float(power[-1])
    shares = power / total if total > 0.0 else np.arange(1, len(order) + 1) / len(order)
    lowest, highest = (
        float(ordered[np.searchsorted(shares, q)])
        for q in (0.5 * (1.0 - DRAWN_POWER_SHARE), 0.5 * (1.0 + DRAWN_POWER_SHARE))
    )
    inside = (ordered >= lowest - (highest - lowest)) & (ordered <= highest + (highest - lowest))
    drawn, weight = ordered[inside], np.diff(shares, prepend=0.0)[inside]
    mixed = np.cumsum(weight / max(float(weight.sum()), 1e-300) + 1.0 / len(drawn))
    wanted = np.searchsorted(mixed, np.arange(1, count) / count * mixed[-1])
    cuts = [0]
    for cut in wanted.tolist():
        if cut - cuts[-1] >= FEWEST_IN_BIN and len(drawn) - cut >= FEWEST_IN_BIN:
            cuts.append(cut)
    return np.unique(np.concatenate([drawn[cuts], drawn[-1:]]))


def bin_of(values: Array, edges: Array) -> Groups:
    """Return the bin of each value, -1 outside."""
    bins = np.searchsorted(edges, values, side="right") - 1
    bins[values == edges[-1]] = len(edges) - 2
    return np.where((values < edges[0]) | (values > edges[-1]), -1, bins)


def explained_share(part: Array, bins: Groups) -> float:
    """Return the share of an effect's power that its bin means explain; bins with few samples explain nothing."""
    inside = bins >= 0
    counts = np.bincount(bins[inside])
    sums = np.bincount(bins[inside], weights=part[inside])
    total = float(np.sum(part**2))
    enough = counts >= FEWEST_IN_BIN
    return float(np.sum(sums[enough] ** 2 / counts[enough])) / total if total > 0.0 else 0.0


def best_sign(part: Array, bins: Groups, signs: Mapping[str, Array]) -> Along:
    """Return the sign along which most of an effect's part follows a variable; none where no sign does as well."""
    fits = [Along("", explained_share(part, bins))]
    fits += [Along(name, explained_share(part * sign, bins)) for name, sign in signs.items()]
    most = max(fit.explained for fit in fits)
    return next(fit for fit in fits if fit.explained >= EQUAL_SHARE * most)


def means(values: Array, bin_of_row: Groups, groups: Groups, bins: int) -> Means:
    """Return the means in bins; their intervals count a stretch once, however many rows it has (cluster-robust)."""
    mean, half = np.full(bins, np.nan), np.full(bins, np.nan)
    for index in range(bins):
        inside = bin_of_row == index
        count = int(inside.sum())
        if count < FEWEST_IN_BIN:
            continue
        mean[index] = float(values[inside].mean())
        _, of_group = np.unique(groups[inside], return_inverse=True)
        sums = np.bincount(of_group, weights=values[inside] - mean[index])
        if len(sums) > 1:
            spread = np.sqrt(len(sums) / (len(sums) - 1) * float(sums @ sums)) / count
            half[index] = spread * float(stats.t.ppf(0.5 * (1.0 + MEAN_CONFIDENCE), len(sums) - 1))
    return Means(mean, mean - half, mean + half)


def fold_angle(angle: Array, periods: float) -> Array:
    """Fold an angle into one period, of `periods` in a turn."""
    period = 2.0 * np.pi / periods
    return np.asarray(np.mod(angle, period), np.float64)


def repeats(angle: Array, periods: float, explained: Callable[[Array], float]) -> bool:
    """Return whether an effect's part follows the folded angle as well as the angle; no, for less than one period.

    explained : returns the share of the part that its means over a variable explain.
    """
    if np.ptp(angle) <= 2.0 * np.pi / periods:
        return False
    return explained(fold_angle(angle, periods)) >= EQUAL_SHARE * explained(angle)


def periods_of(cause: Cause) -> float:
    """Return how often an effect repeats in a turn; 1 for an effect without an order."""
    return next((item.value for item in cause.parameters if item.name == ORDER_PARAMETER), 1.0)


def last_reversal(speed: Array) -> Groups:
    """Return for each sample the index at which the sign of the speed last changed."""
    reversals = np.flatnonzero(np.diff(np.sign(speed), prepend=np.sign(speed[0])) != 0)
    latest = np.zeros(len(speed), np.intp)
    latest[reversals] = reversals
    return np.asarray(np.maximum.accumulate(latest), np.intp)


def first_that_follows(views: Sequence[View], explained: Callable[[View], float]) -> View | None:
    """Return the first view that explains enough of an effect's part, else the one that explains most."""
    enough = [view for view in views if explained(view) >= LEAST_FOLLOWED_SHARE]
    return next(iter(enough), None) or max(views, key=explained, default=None)
