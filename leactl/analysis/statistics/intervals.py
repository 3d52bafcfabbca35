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
OFFSETS = 128  # offsets of the grid of steps that are tried, evenly over one step


def half_width(std: float, dof: float, *limits: float) -> float:
    """Half width of the 95 % interval of a sum of errors, of which some are uniform and the rest normal.

    Parameters
    ----------
    std, dof : of the part that scatters: standard uncertainty, and the degrees of freedom that it rests on.
    limits : of each part that is evenly spread between plus and minus its limit; all but the largest count as normal.
    """
    from scipy.optimize import brentq
    from scipy.special import ndtr

    largest, *others = sorted((abs(limit) for limit in limits), reverse=True) if limits else [0.0]
    normal = t_quantile(math.inf)
    spread = math.hypot(std * t_quantile(dof) / normal, *(limit / math.sqrt(3.0) for limit in others))
    if spread <= 1e-6 * largest:
        return CONFIDENCE * largest
    if largest <= 1e-6 * spread:
        return normal * spread

    def integrated_cdf(x: float) -> float:  # integral of the normal distribution function
        return x * float(ndtr(x)) + math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)

    def missing_coverage(width: float) -> float:
        limits_scaled = (width + largest) / spread, (width - largest) / spread
        return spread / (2.0 * largest) * (integrated_cdf(limits_scaled[0]) - integrated_cdf(limits_scaled[1])) - (
            0.5 + CONFIDENCE / 2
        )

    return float(brentq(missing_coverage, 0.0, normal * spread + largest))


def rounding_limit(values: Array, step: float, weights: Array) -> float:
    """Limit of a uniform error that matches the 95 % quantile of the rounding error of a weighted sum of readings.

    A level that moves over several steps leaves little rounding error in the sum; a level within a step leaves half a
    step.

    Parameters
    ----------
    values : a smooth curve through what was read.
    step : between two readings; 0 where none shows.
    weights : of the readings in the sum.
    """
    if step <= 0.0:
        return 0.0
    shifted = values[np.newaxis] / step + (np.arange(OFFSETS) / OFFSETS)[:, np.newaxis]
    errors = (np.round(shifted) - shifted) @ weights
    return step * float(np.quantile(np.abs(errors - errors.mean()), CONFIDENCE)) / CONFIDENCE


def rounding_of(readings: Array, step: float) -> float:
    """Standard uncertainty that rounding leaves in the mean of one level's readings; noise averages it out."""
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
