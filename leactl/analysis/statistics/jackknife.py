"""Mean over levels of a figure that all trials of a level give together, with its interval from leaving trials out.

Efron & Tibshirani, An Introduction to the Bootstrap (1993), chapter 11: standard error. The bias that
it estimates is not taken out: with few trials that scatters by more than the bias there is.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from leactl.analysis.estimate import NAN, Estimate
from leactl.analysis.statistics.intervals import half_width

SHOWN = 4.0  # by which trials that round each by itself may scatter less than that makes them


class TrialFigure(NamedTuple):
    """A figure of one level, and the limits of errors, evenly spread, that more trials do not make smaller."""

    value: float
    shared: tuple[float, ...] = ()  # the same in every level, as where the samples lie on the response
    own: tuple[float, ...] = ()  # of this level alone, as the rounding of its readings


@dataclass(frozen=True)
class LevelValue:
    """A figure of one level with its uncertainties."""

    reading: TrialFigure
    scatter: float  # standard error from the trials; NaN with one
    dof: int


def over_trials(trials: int, figure: Callable[[Sequence[int]], TrialFigure]) -> LevelValue:
    """Figure of these many trials, with its standard error from the figures that each trial left out gives.

    `figure` takes the trials to use by their places; NaN where it has no value for them.
    """
    every = figure(range(trials))
    if trials < 2 or not math.isfinite(every.value):
        return LevelValue(every, NAN, trials - 1)
    without = np.array([figure([k for k in range(trials) if k != left_out]).value for left_out in range(trials)])
    scatter = math.sqrt((trials - 1) / trials * float(np.sum((without - without.mean()) ** 2)))
    own = sum(limit**2 for limit in every.own)
    unseen = math.sqrt(max(1.0 - SHOWN * 3.0 * trials * scatter**2 / own, 0.0)) if own else 0.0
    return LevelValue(every._replace(own=tuple(unseen * limit for limit in every.own)), scatter, trials - 1)


def mean_of_levels(name: str, units: str, levels: Sequence[LevelValue]) -> Estimate:
    """Mean over the levels with its 95 % interval (GUM, G.4: Welch and Satterthwaite); no interval with one trial."""
    count = len(levels)
    value = sum(level.reading.value for level in levels) / count
    scatter = [(level.scatter / count) ** 2 for level in levels]
    limits = [sum(parts) / count for parts in zip_longest(*(level.reading.shared for level in levels), fillvalue=0.0)]
    limits += [limit / count for level in levels for limit in level.reading.own]
    scattered = math.sqrt(sum(scatter))
    if not math.isfinite(scattered):
        return Estimate(name, value, NAN, NAN, NAN, units)
    weight = sum(part**2 / level.dof for part, level in zip(scatter, levels, strict=True))
    half = half_width(scattered, scattered**4 / weight if weight else math.inf, *limits)
    std = math.hypot(scattered, *(limit / math.sqrt(3.0) for limit in limits))
    return Estimate(name, value, std, value - half, value + half, units)
