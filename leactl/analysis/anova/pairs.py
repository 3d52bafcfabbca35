"""Tukey's comparison of all pairs of conditions (Tukey-Kramer for unequal numbers), and its smallest visible effect."""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from leactl.analysis.anova.one_way import SIGNIFICANCE, Anova, combined_error
from leactl.analysis.anova.values import Values

CHI_PARTS = 2000  # of the distribution of the standard error
POWER = 0.8  # share of such experiments in which the smallest visible difference would have passed the test


@dataclass(frozen=True)
class PairwiseDifference:
    """Difference between two conditions, adjusted for actuators; the intervals hold for all pairs at once."""

    first: str
    second: str
    difference: float  # second minus first
    std: float
    dof: float
    low: float
    high: float
    compared: int  # conditions
    smallest_seen: float  # size of a difference that would have passed this test in `POWER` of such experiments

    @property
    def shown(self) -> bool:
        """Return whether the difference is more than chance."""
        return self.low > 0.0 or self.high < 0.0

    @property
    def p(self) -> float:
        """Return the probability of so large a difference between any two conditions if all were equal."""
        from scipy.stats import studentized_range

        return float(studentized_range.sf(math.sqrt(2.0) * abs(self.difference) / self.std, self.compared, self.dof))


def pairs(values: Values, anova: Anova) -> list[PairwiseDifference]:
    """Compare every pair of conditions."""
    design = anova.design
    columns, count = design.additive, len(design.conditions)
    inverse = np.linalg.pinv(columns)
    differences = []
    for first in range(count):
        for second in range(first + 1, count):
            contrast = np.zeros(columns.shape[1])
            contrast[first], contrast[second] = -1.0, 1.0
            weights = contrast @ inverse  # of the values in the difference
            spread = float(np.sum((weights @ design.cell) ** 2)) if anova.error.interaction else 0.0
            variance, dof = combined_error(anova.error, float(weights @ weights), spread)
            std, difference = math.sqrt(variance), float(weights @ values.value)
            critical = _critical(count, round(dof, 6))
            differences.append(
                PairwiseDifference(
                    design.conditions[first],
                    design.conditions[second],
                    difference,
                    std,
                    dof,
                    difference - critical * std,
                    difference + critical * std,
                    count,
                    std * _visible_difference(critical, round(dof, 6)),
                )
            )
    return differences


@cache
def _critical(conditions: int, dof: float) -> float:
    """Return the difference in standard errors beyond which a pair is significant."""
    from scipy.stats import studentized_range

    return float(studentized_range.ppf(1.0 - SIGNIFICANCE, conditions, dof)) / math.sqrt(2.0)


@cache
def _visible_difference(critical: float, dof: float) -> float:
    """Return the true difference, in standard errors, that passes the test in a share `POWER` of experiments.

    The estimated standard error has a chi distribution, which is divided into parts of equal probability.
    """
    from scipy.optimize import brentq
    from scipy.stats import chi2, norm

    error = np.sqrt(chi2.ppf((np.arange(CHI_PARTS) + 0.5) / CHI_PARTS, dof) / dof)

    def power(size: float) -> float:
        return float(np.mean(norm.sf(critical * error - size) + norm.cdf(-critical * error - size)))

    return float(brentq(lambda size: power(size) - POWER, 0.0, critical * float(error[-1]) + 10.0))
