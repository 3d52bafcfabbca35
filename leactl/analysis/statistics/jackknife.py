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
"""Largest rounding variance that the scatter of trials is taken to contain, as a multiple of a single trial's variance.

Trials that each round by themselves scatter at least by their rounding; a few of them may by chance scatter less. The
factor was chosen, not derived.
"""


class LevelFigure(NamedTuple):
    """A figure of one level, with the half widths of uniform errors that averaging over trials does not reduce.

    Element k of `shared` has to be the limit of the same error in every level: `mean_of_levels` averages it over the
    levels and does not reduce it. Each element of `per_level` is an error that is independent of all others.
    """

    value: float
    shared: tuple[float, ...] = ()  # alike in every level, such as the position of the samples on the response
    per_level: tuple[float, ...] = ()  # of this level alone, such as the rounding of its readings


@dataclass(frozen=True)
class JackknifedFigure:
    """A figure of one level with its standard error."""

    figure: LevelFigure
    # of the figure, from the scatter of the trials; NaN with one trial, or if a choice of trials gives no value
    standard_error: float
    dof: int  # degrees of freedom: trials less one


def jackknife_over_trials(trial_count: int, figure: Callable[[Sequence[int]], LevelFigure]) -> JackknifedFigure:
    """Return a figure of all trials of a level, with its standard error from leaving out one trial at a time.

    `figure` takes the indices of the trials to use, and returns NaN if they give no value. Limits in `per_level` are
    reduced by the part that the scatter of the trials already contains (`SCATTER_ALLOWANCE`).
    """
    full_figure = figure(range(trial_count))
    if trial_count < 2 or not math.isfinite(full_figure.value):
        return JackknifedFigure(full_figure, NAN, trial_count - 1)
    leave_one_out = np.array(
        [figure([k for k in range(trial_count) if k != omitted]).value for omitted in range(trial_count)]
    )
    standard_error = math.sqrt(
        (trial_count - 1) / trial_count * float(np.sum((leave_one_out - leave_one_out.mean()) ** 2))
    )
    rounding_square = sum(limit**2 for limit in full_figure.per_level)
    # a uniform error has a third of its squared limit as variance; one trial has `trial_count` times that of the figure
    covered_square = SCATTER_ALLOWANCE * 3.0 * trial_count * standard_error**2
    remaining = math.sqrt(max(1.0 - covered_square / rounding_square, 0.0)) if rounding_square else 0.0
    return JackknifedFigure(
        full_figure._replace(per_level=tuple(remaining * limit for limit in full_figure.per_level)),
        standard_error,
        trial_count - 1,
    )


def mean_of_levels(name: str, units: str, levels: Sequence[JackknifedFigure]) -> Estimate:
    """Average the figure over the levels, with its 95 % interval (GUM, G.4: Welch and Satterthwaite).

    Standard uncertainty and interval are NaN if the standard error of any level is.

    Parameters
    ----------
    levels : one or more.
    """
    count = len(levels)
    value = sum(level.figure.value for level in levels) / count
    variances = [(level.standard_error / count) ** 2 for level in levels]
    limits = [
        sum(level_limits) / count
        for level_limits in zip_longest(*(level.figure.shared for level in levels), fillvalue=0.0)
    ]
    limits += [limit / count for level in levels for limit in level.figure.per_level]
    combined_standard_error = math.sqrt(sum(variances))
    if not math.isfinite(combined_standard_error):
        return Estimate(name, value, NAN, NAN, NAN, units)
    satterthwaite_sum = sum(variance**2 / level.dof for variance, level in zip(variances, levels, strict=True))
    half_interval = half_width(
        combined_standard_error,
        combined_standard_error**4 / satterthwaite_sum if satterthwaite_sum else math.inf,
        *limits,
    )
    std = math.hypot(combined_standard_error, *(limit / math.sqrt(3.0) for limit in limits))
    return Estimate(name, value, std, value - half_interval, value + half_interval, units)
