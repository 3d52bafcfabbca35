"""Mean over levels of a figure that all trials of a level give together, with its interval from leaving trials out.

Efron & Tibshirani, An Introduction to the Bootstrap (1993), chapters 10 and 11: bias and standard error.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from leactl.analysis.estimate import NAN, Estimate
from leactl.analysis.regression import t_quantile


class Reading(NamedTuple):
    """A figure of one level, and standard uncertainties that more trials do not make smaller."""

    value: float
    shared: float = 0.0  # the same in every level, as where the samples lie on the response
    own: float = 0.0  # of this level alone, as the rounding of its readings


@dataclass(frozen=True)
class LevelValue:
    """A figure of one level with its uncertainties."""

    reading: Reading
    scatter: float  # standard error from the trials; NaN with one
    dof: int


def over_trials(trials: int, figure: Callable[[Sequence[int]], Reading]) -> LevelValue:
    """Figure of these many trials, its bias taken out, from the figures that each trial left out gives.

    `figure` takes the trials to use by their places; NaN where it has no value for them.
    """
    every = figure(range(trials))
    if trials < 2 or not math.isfinite(every.value):
        return LevelValue(every, NAN, trials - 1)
    without = np.array([figure([k for k in range(trials) if k != left_out]).value for left_out in range(trials)])
    bias = (trials - 1) * (float(without.mean()) - every.value)
    scatter = math.sqrt((trials - 1) / trials * float(np.sum((without - without.mean()) ** 2)))
    return LevelValue(every._replace(value=every.value - bias), scatter, trials - 1)


def mean_of_levels(name: str, units: str, levels: Sequence[LevelValue]) -> Estimate:
    """Mean over the levels with its 95 % interval (GUM, G.4: Welch and Satterthwaite); no interval with one trial."""
    count = len(levels)
    value = sum(level.reading.value for level in levels) / count
    scatter = [(level.scatter / count) ** 2 for level in levels]
    fixed = (sum(level.reading.shared for level in levels) / count) ** 2
    fixed += sum((level.reading.own / count) ** 2 for level in levels)
    std = math.sqrt(sum(scatter) + fixed)
    if not math.isfinite(std):
        return Estimate(name, value, NAN, NAN, NAN, units)
    weight = sum(part**2 / level.dof for part, level in zip(scatter, levels, strict=True))
    half = t_quantile(std**4 / weight if weight > 1e-18 * std**4 else math.inf) * std
    return Estimate(name, value, std, value - half, value + half, units)
