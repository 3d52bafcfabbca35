"""What is left over over one variable: means in bins with intervals, counted along the sign that an effect follows.

Bins follow from the data: as many as Rice's rule gives for independent samples, with edges at quantiles of the
samples and of what the effect does there, so that a bin is fine where the effect acts.
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
ORDER = "order"  # parameter that says how often an effect repeats in a turn
MOST_BINS = 24  # that a drawing shows apart
FEWEST_BINS = 12  # that show a wave
FEWEST_IN_BIN = 8
FOLLOWED = 0.5  # of an effect's part, that the first of its variables is to explain
ACTS = 0.99  # of an effect's power, that the range drawn holds before its width is put to either side
LEVELLED = 0.95  # two-sided confidence of a bin's mean
ALIKE = 0.9  # of what the best sign explains, from which on an earlier one is taken


@dataclass(frozen=True, eq=False)
class Means:
    """Mean in each bin with its interval; NaN where a bin has too few independent stretches for one."""

    mean: Array
    low: Array
    high: Array

    def rms(self, counts: Groups) -> float:
        """Root mean square of the means, each counted by its samples."""
        known = np.isfinite(self.mean)
        return float(np.sqrt(np.sum(counts[known] * self.mean[known] ** 2) / max(float(counts[known].sum()), 1.0)))

    @property
    def off_zero(self) -> int:
        """How many intervals do not hold zero."""
        return int(np.sum((self.low > 0.0) | (self.high < 0.0)))


@dataclass(frozen=True)
class Along:
    """The sign that a residual is counted along, and how much of an effect's part then follows the variable."""

    name: str  # empty where it is counted as it is
    explained: float


def bin_count(independent: float) -> int:
    """Rice's rule for so many independent samples."""
    return int(np.clip(2.0 * independent ** (1.0 / 3.0), FEWEST_BINS, MOST_BINS))


def bin_edges(values: Array, part: Array, count: int) -> Array:
    """Edges at quantiles, half by samples and half by the power of an effect's part; between levels where few occur.

    Ends lie where the effect acts, its range once more to either side.
    """
    levels = np.unique(values)
    if len(levels) <= count:
        between = 0.5 * (levels[1:] + levels[:-1])
        half = 0.25 * float(np.min(np.diff(levels))) if len(levels) > 1 else 0.5
        return np.concatenate([levels[:1] - half, between, levels[-1:] + half])
    order = np.argsort(values, kind="stable")
    ordered, power = values[order], np.cumsum(part[order] ** 2)
    total = float(power[-1])
    shares = power / total if total > 0.0 else np.arange(1, len(order) + 1) / len(order)
    first, last = (float(ordered[np.searchsorted(shares, q)]) for q in (0.5 * (1.0 - ACTS), 0.5 * (1.0 + ACTS)))
    inside = (ordered >= first - (last - first)) & (ordered <= last + (last - first))
    shown, weight = ordered[inside], np.diff(shares, prepend=0.0)[inside]
    mixed = np.cumsum(weight / max(float(weight.sum()), 1e-300) + 1.0 / len(shown))
    wanted = np.searchsorted(mixed, np.arange(1, count) / count * mixed[-1])
    cuts = [0]
    for at in wanted.tolist():
        if at - cuts[-1] >= FEWEST_IN_BIN and len(shown) - at >= FEWEST_IN_BIN:
            cuts.append(at)
    return np.unique(np.concatenate([shown[cuts], shown[-1:]]))


def bin_of(values: Array, edges: Array) -> Groups:
    """The bin of each value, -1 outside."""
    place = np.searchsorted(edges, values, side="right") - 1
    place[values == edges[-1]] = len(edges) - 2
    return np.where((values < edges[0]) | (values > edges[-1]), -1, place)


def follows(part: Array, place: Groups) -> float:
    """Share of an effect's part that its means in bins explain; one of few samples explains nothing."""
    inside = place >= 0
    counts = np.bincount(place[inside])
    sums = np.bincount(place[inside], weights=part[inside])
    total = float(np.sum(part**2))
    enough = counts >= FEWEST_IN_BIN
    return float(np.sum(sums[enough] ** 2 / counts[enough])) / total if total > 0.0 else 0.0


def best_sign(part: Array, place: Groups, signs: Mapping[str, Array]) -> Along:
    """The sign along which most of an effect's part follows a variable; the plain one where that does as well."""
    fits = [Along("", follows(part, place))]
    fits += [Along(name, follows(part * sign, place)) for name, sign in signs.items()]
    most = max(one.explained for one in fits)
    return next(one for one in fits if one.explained >= ALIKE * most)


def means(values: Array, place: Groups, groups: Groups, bins: int) -> Means:
    """Means in bins; their intervals count a stretch once, however many rows it has (cluster-robust)."""
    mean, half = np.full(bins, np.nan), np.full(bins, np.nan)
    for index in range(bins):
        inside = place == index
        count = int(inside.sum())
        if count < FEWEST_IN_BIN:
            continue
        mean[index] = float(values[inside].mean())
        _, of_group = np.unique(groups[inside], return_inverse=True)
        sums = np.bincount(of_group, weights=values[inside] - mean[index])
        if len(sums) > 1:
            spread = np.sqrt(len(sums) / (len(sums) - 1) * float(sums @ sums)) / count
            half[index] = spread * float(stats.t.ppf(0.5 * (1.0 + LEVELLED), len(sums) - 1))
    return Means(mean, mean - half, mean + half)


def turned(angle: Array, periods: float) -> Array:
    """An angle within one of so many periods of a turn."""
    whole = 2.0 * np.pi / periods
    return np.asarray(np.mod(angle, whole), np.float64)


def repeats(angle: Array, periods: float, explained: Callable[[Array], float]) -> bool:
    """Whether an effect's part follows an angle within one of so many periods as well as the angle itself.

    What turns less than one of them repeats nothing.

    explained : share of the part that its means over a variable explain.
    """
    if np.ptp(angle) <= 2.0 * np.pi / periods:
        return False
    return explained(turned(angle, periods)) >= ALIKE * explained(angle)


def periods_of(cause: Cause) -> float:
    """How often an effect repeats in a turn; once where nothing says otherwise."""
    return next((item.value for item in cause.parameters if item.name == ORDER), 1.0)


def last_reversal(speed: Array) -> Groups:
    """For each sample, that at which the sign of the speed last changed."""
    reversals = np.flatnonzero(np.diff(np.sign(speed), prepend=np.sign(speed[0])) != 0)
    last = np.zeros(len(speed), np.intp)
    last[reversals] = reversals
    return np.asarray(np.maximum.accumulate(last), np.intp)


def first_that_follows(views: Sequence[View], explained: Callable[[View], float]) -> View | None:
    """The first view that explains enough of an effect's part, else the one that explains most."""
    enough = [view for view in views if explained(view) >= FOLLOWED]
    return next(iter(enough), None) or max(views, key=explained, default=None)
