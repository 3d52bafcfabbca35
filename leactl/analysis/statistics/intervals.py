"""Half widths of 95 % intervals where an error is not all normal: steps of a reading, a tolerance, a quartz's limits.

What is evenly spread between limits never leaves them, so that 1.96 of its standard deviations would hold it always
(JCGM 101:2008, propagation of distributions; GUM G.1.5).
"""

import math

import numpy as np
import numpy.typing as npt

from leactl.analysis.statistics.regression import CONFIDENCE, t_quantile

Array = npt.NDArray[np.float64]

ON_STEPS = 0.05  # of a step, by which a reading may lie beside it
OFFSETS = 128  # places of a display's steps that are tried, evenly over one step


def half_width(std: float, dof: float, *limits: float) -> float:
    """Half width of the 95 % interval of a sum of errors.

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

    def summed(x: float) -> float:  # integral of the normal distribution function
        return x * float(ndtr(x)) + math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)

    def short(half: float) -> float:
        ends = (half + largest) / spread, (half - largest) / spread
        return spread / (2.0 * largest) * (summed(ends[0]) - summed(ends[1])) - (0.5 + CONFIDENCE / 2)

    return float(brentq(short, 0.0, normal * spread + largest))


def rounding_limit(values: Array, step: float, weights: Array) -> float:
    """Limit of an evenly spread error that is beyond 95 % of it as often as what the steps of a reading do to a sum.

    A level that moves crosses steps, which leaves little in sum(weights * readings); one that stays within a step has
    half a step left.

    Parameters
    ----------
    values : a smooth curve through what was read.
    step : between two readings; 0 where none shows.
    weights : of the readings in the sum.
    """
    if step <= 0.0:
        return 0.0
    read = values[np.newaxis] / step + (np.arange(OFFSETS) / OFFSETS)[:, np.newaxis]
    errors = (np.round(read) - read) @ weights
    return step * float(np.quantile(np.abs(errors - errors.mean()), CONFIDENCE)) / CONFIDENCE


def rounding_of(readings: Array, step: float) -> float:
    """Standard uncertainty of the mean of one level's readings by their steps; noise lets them fall to either side."""
    seen = readings[np.isfinite(readings)]
    if step <= 0.0 or not len(seen):
        return 0.0
    return step / math.sqrt(12.0) * math.exp(-2.0 * (math.pi * float(np.std(seen)) / step) ** 2)


def step_of(readings: Array) -> float:
    """The step between two readings, of which all are multiples apart; 0 where there is none."""
    values = np.unique(readings[np.isfinite(readings)])
    steps = np.diff(values)
    clear = steps[steps > 1e-9 * float(np.max(np.abs(values), initial=0.0))]
    if not len(clear):
        return 0.0
    step = float(clear.min())
    apart = (values - values[0]) / step
    return step if float(np.max(np.abs(apart - np.round(apart)))) < ON_STEPS else 0.0
