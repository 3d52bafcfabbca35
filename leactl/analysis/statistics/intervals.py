"""Half widths of 95 % intervals for sums of normal and uniform errors: quantisation, tolerances, clock limits.

A uniform error never exceeds its limits, but 1.96 of its standard deviations are 1.13 limits: too wide for 95 % (JCGM
101:2008, propagation of distributions; GUM G.1.5).
"""

import math

import numpy as np
import numpy.typing as npt

from leactl.analysis.statistics.regression import CONFIDENCE, t_quantile

Array = npt.NDArray[np.float64]

MOST_OFF_GRID = 0.05  # of a step; readings that lie further off the grid of steps show no quantisation
GRID_OFFSETS = 128  # offsets of the grid of steps that are computed, evenly over one step


def half_width(std: float, dof: float, *limits: float) -> float:
    """Return the half width of the 95 % interval of a sum of normal and uniform errors.

    Parameters
    ----------
    std, dof : standard uncertainty of the normal errors, and its degrees of freedom.
    limits : of the uniform errors, which lie between plus and minus the limit; all but the largest count as normal.
    """
    from scipy.optimize import brentq
    from scipy.special import ndtr

    largest_limit, *other_limits = sorted((abs(limit) for limit in limits), reverse=True) if limits else [0.0]
    normal_quantile = t_quantile(math.inf)
    normal_std = math.hypot(
        std * t_quantile(dof) / normal_quantile, *(limit / math.sqrt(3.0) for limit in other_limits)
    )
    if normal_std <= 1e-6 * largest_limit:
        return CONFIDENCE * largest_limit
    if largest_limit <= 1e-6 * normal_std:
        return normal_quantile * normal_std

    def integrated_cdf(x: float) -> float:  # integral of the normal distribution function
        return x * float(ndtr(x)) + math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)

    def excess_probability(width: float) -> float:
        # probability that the sum is below `width`, minus that at the end of the two-sided interval
        upper, lower = (width + largest_limit) / normal_std, (width - largest_limit) / normal_std
        below_width = normal_std / (2.0 * largest_limit) * (integrated_cdf(upper) - integrated_cdf(lower))
        return below_width - (0.5 + CONFIDENCE / 2)

    return float(brentq(excess_probability, 0.0, normal_quantile * normal_std + largest_limit))


def rounding_limit(values: Array, step: float, weights: Array) -> float:
    """Return the limit of a uniform error that has the 95 % quantile of a weighted sum's rounding error.

    A level that moves over several steps leaves little rounding error in the sum; a level within a step leaves half a
    step.

    Parameters
    ----------
    values : a smooth curve through the readings, shape (n,).
    step : quantisation step of the readings; 0 if none shows.
    weights : of the readings in the sum, shape (n,).
    """
    if step <= 0.0:
        return 0.0
    shifted_steps = values[np.newaxis] / step + (np.arange(GRID_OFFSETS) / GRID_OFFSETS)[:, np.newaxis]
    errors = (np.round(shifted_steps) - shifted_steps) @ weights
    return step * float(np.quantile(np.abs(errors - errors.mean()), CONFIDENCE)) / CONFIDENCE


def rounding_std(readings: Array, step: float) -> float:
    """Return the standard uncertainty that rounding causes in the mean of one level's readings; noise reduces it."""
    finite = readings[np.isfinite(readings)]
    if step <= 0.0 or not len(finite):
        return 0.0
    return step / math.sqrt(12.0) * math.exp(-2.0 * (math.pi * float(np.std(finite)) / step) ** 2)


def quantisation_step(readings: Array) -> float:
    """Return the smallest difference of readings if all differences are multiples of it, else 0."""
    values = np.unique(readings[np.isfinite(readings)])
    steps = np.diff(values)
    steps_above_roundoff = steps[steps > 1e-9 * float(np.max(np.abs(values), initial=0.0))]
    if not len(steps_above_roundoff):
        return 0.0
    step = float(steps_above_roundoff.min())
    multiples = (values - values[0]) / step
    return step if float(np.max(np.abs(multiples - np.round(multiples)))) < MOST_OFF_GRID else 0.0
