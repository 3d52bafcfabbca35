"""Half widths of 95 % intervals for sums of normal and uniform errors: quantisation, tolerances, clock limits.

A uniform error never exceeds its limits, and 1.96 of its standard deviations are 1.13 limits: too wide for 95 %
(JCGM 101:2008, propagation of distributions; GUM G.1.5).
"""

import math

import numpy as np
import numpy.typing as npt

from leactl.analysis.statistics.regression import CONFIDENCE, t_quantile

Array = npt.NDArray[np.float64]

MOST_OFF_GRID = 0.05  # of a step, by which a reading may lie off the grid of steps
GRID_OFFSETS = 128  # offsets of the grid of steps that are tried, evenly over one step


def half_width(std: float, dof: float, *limits: float) -> float:
    """Return the half width of the 95 % interval of a sum of normal and uniform errors.

    Parameters
    ----------
    std, dof : standard uncertainty of the normal errors, and its degrees of freedom.
    limits : of the uniform errors, each between plus and minus its limit; all but the largest count as normal.
    """
    from scipy.optimize import brentq
    from scipy.special import ndtr

    largest, *others = sorted((abs(limit) for limit in limits), reverse=True) if limits else [0.0]
    normal_quantile = t_quantile(math.inf)
    normal_std = math.hypot(std * t_quantile(dof) / normal_quantile, *(limit / math.sqrt(3.0) for limit in others))
    if normal_std <= 1e-6 * largest:
        return CONFIDENCE * largest
    if largest <= 1e-6 * normal_std:
        return normal_quantile * normal_std

    def integrated_cdf(x: float) -> float:  # integral of the normal distribution function
        return x * float(ndtr(x)) + math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)

    def excess_probability(width: float) -> float:
        # probability that the sum is below `width`, over the one at the end of the two-sided interval
        upper, lower = (width + largest) / normal_std, (width - largest) / normal_std
        below_width = normal_std / (2.0 * largest) * (integrated_cdf(upper) - integrated_cdf(lower))
        return below_width - (0.5 + CONFIDENCE / 2)

    return float(brentq(excess_probability, 0.0, normal_quantile * normal_std + largest))


def rounding_limit(values: Array, step: float, weights: Array) -> float:
    """Return the limit of a uniform error with the 95 % quantile of the rounding error of a weighted sum of readings.

    A level that moves over several steps leaves little rounding error in the sum; a level within a step leaves half a
    step.

    Parameters
    ----------
    values : a smooth curve through the readings, shape (n,).
    step : quantisation step of the readings; 0 where none shows.
    weights : of the readings in the sum, shape (n,).
    """
    if step <= 0.0:
        return 0.0
    shifted = values[np.newaxis] / step + (np.arange(GRID_OFFSETS) / GRID_OFFSETS)[:, np.newaxis]
    errors = (np.round(shifted) - shifted) @ weights
    return step * float(np.quantile(np.abs(errors - errors.mean()), CONFIDENCE)) / CONFIDENCE


def rounding_std(readings: Array, step: float) -> float:
    """Return the standard uncertainty of the mean of one level's readings by rounding; noise averages it out."""
    finite = readings[np.isfinite(readings)]
    if step <= 0.0 or not len(finite):
        return 0.0
    return step / math.sqrt(12.0) * math.exp(-2.0 * (math.pi * float(np.std(finite)) / step) ** 2)


def quantisation_step(readings: Array) -> float:
    """Return the quantisation step: the smallest difference, if all are multiples of it; 0 if they are not."""
    values = np.unique(readings[np.isfinite(readings)])
    steps = np.diff(values)
    steps_above_rounding = steps[steps > 1e-9 * float(np.max(np.abs(values), initial=0.0))]
    if not len(steps_above_rounding):
        return 0.0
    step = float(steps_above_rounding.min())
    multiples = (values - values[0]) / step
    return step if float(np.max(np.abs(multiples - np.round(multiples)))) < MOST_OFF_GRID else 0.0
