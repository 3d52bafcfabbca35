"""Jackknife of a figure over the trials of each level, and the mean of the figure over the levels.

Efron & Tibshirani, An Introduction to the Bootstrap (1993), chapter 11: standard error. The jackknife's estimate of
the bias is not subtracted: with few trials it scatters by more than the bias itself.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from leactl.analysis.estimate import NAN, Estimate
from leactl.analysis.statistics.intervals import half_width

SCATTER_ALLOWANCE = 4.0
"""Rounding variance for which the scatter of the trials accounts, over the variance of a single trial.

Trials that each round by themselves scatter at least by their rounding; a few of them may by chance scatter less. The
factor was chosen, not derived.
"""


class TrialFigure(NamedTuple):
    """A figure of one level, and the limits of its uniform errors that more trials do not make smaller.

    Element k of `shared` has to be the limit of the same error in every level: `mean_of_levels` averages it over the
    levels and does not reduce it. Each element of `per_level` is an error of its own.
    """

    value: float
    shared: tuple[float, ...] = ()  # alike in every level, such as the position of the samples on the response
    per_level: tuple[float, ...] = ()  # of this level alone, such as the rounding of its readings


@dataclass(frozen=True)
class LevelValue:
    """A figure of one level with its standard error."""

    figure: TrialFigure
    standard_error: float  # of the figure, from the scatter of the trials; NaN with one trial
    dof: int


def over_trials(trials: int, figure: Callable[[Sequence[int]], TrialFigure]) -> LevelValue:
    """Return a figure of all trials of a level, with its standard error from leaving out one trial at a time.

    `figure` takes the indices of the trials to use, and returns NaN where it has no value for them.
    """
    of_all_trials = figure(range(trials))
    if trials < 2 or not math.isfinite(of_all_trials.value):
        return LevelValue(of_all_trials, NAN, trials - 1)
    leave_one_out = np.array([figure([k for k in range(trials) if k != left_out]).value for left_out in range(trials)])
    scatter = math.sqrt((trials - 1) / trials * float(np.sum((leave_one_out - leave_one_out.mean()) ** 2)))
    rounding_square = sum(limit**2 for limit in of_all_trials.per_level)
    # the variance of a uniform error is a third of its limit squared, that of one trial `trials` times the scatter's
    covered = SCATTER_ALLOWANCE * 3.0 * trials * scatter**2
    remaining = math.sqrt(max(1.0 - covered / rounding_square, 0.0)) if rounding_square else 0.0
    return LevelValue(
        of_all_trials._replace(per_level=tuple(remaining * limit for limit in of_all_trials.per_level)),
        scatter,
        trials - 1,
    )


def mean_of_levels(name: str, units: str, levels: Sequence[LevelValue]) -> Estimate:
    """Average the figure over the levels, with its 95 % interval (GUM, G.4: Welch and Satterthwaite).

    There is no interval where a level has one trial.
    """
    count = len(levels)
    value = sum(level.figure.value for level in levels) / count
    variances = [(level.standard_error / count) ** 2 for level in levels]
    limits = [
        sum(level_limits) / count
        for level_limits in zip_longest(*(level.figure.shared for level in levels), fillvalue=0.0)
    ]
    limits += [limit / count for level in levels for limit in level.figure.per_level]
    scatter_std = math.sqrt(sum(variances))
    if not math.isfinite(scatter_std):
        return Estimate(name, value, NAN, NAN, NAN, units)
    satterthwaite_sum = sum(variance**2 / level.dof for variance, level in zip(variances, levels, strict=True))
    half_interval = half_width(
        scatter_std, scatter_std**4 / satterthwaite_sum if satterthwaite_sum else math.inf, *limits
    )
    std = math.hypot(scatter_std, *(limit / math.sqrt(3.0) for limit in limits))
    return Estimate(name, value, std, value - half_interval, value + half_interval, units)
