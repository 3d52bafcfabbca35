"""Tukey's comparison of all pairs of conditions (Tukey-Kramer for unequal numbers), and its smallest visible effect."""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from leactl.analysis.anova.one_way import SIGNIFICANCE, Anova, combined_error
from leactl.analysis.anova.values import Values

CHI_PARTS = 2000  # of equal probability, of the distribution of the standard error
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
    condition_count: int  # of all compared conditions
    smallest_seen: float  # magnitude of a difference that would have passed this test in `POWER` of such experiments

    @property
    def shown(self) -> bool:
        """Return whether the difference is more than chance."""
        return self.low > 0.0 or self.high < 0.0

    @property
    def p(self) -> float:
        """Return the probability of so large a difference between any two conditions if all were equal."""
        from scipy.stats import studentized_range

        return float(
            studentized_range.sf(math.sqrt(2.0) * abs(self.difference) / self.std, self.condition_count, self.dof)
        )


def pairs(values: Values, anova: Anova) -> list[PairwiseDifference]:
    """Return the difference of every pair of conditions."""
    design = anova.design
    columns, condition_count = design.additive, len(design.conditions)
    inverse = np.linalg.pinv(columns)
    differences = []
    for first in range(condition_count):
        for second in range(first + 1, condition_count):
            contrast = np.zeros(columns.shape[1])
            contrast[first], contrast[second] = -1.0, 1.0
            weights = contrast @ inverse  # of the values in the difference
            interaction_factor = float(np.sum((weights @ design.cell) ** 2)) if anova.error.interaction else 0.0
            variance, dof = combined_error(anova.error, float(weights @ weights), interaction_factor)
            std, difference = math.sqrt(variance), float(weights @ values.value)
            critical_value = _critical(condition_count, round(dof, 6))
            differences.append(
                PairwiseDifference(
                    design.conditions[first],
                    design.conditions[second],
                    difference,
                    std,
                    dof,
                    difference - critical_value * std,
                    difference + critical_value * std,
                    condition_count,
                    std * _visible_difference(critical_value, round(dof, 6)),
                )
            )
    return differences


@cache
def _critical(condition_count: int, dof: float) -> float:
    """Return the difference in standard errors beyond which a pair is significant."""
    from scipy.stats import studentized_range

    return float(studentized_range.ppf(1.0 - SIGNIFICANCE, condition_count, dof)) / math.sqrt(2.0)


@cache
def _visible_difference(critical: float, dof: float) -> float:
    """Return the true difference, in standard errors, that passes the test in a share `POWER` of experiments.

    The estimated standard error has a chi distribution, which is divided into parts of equal probability.
    """
    from scipy.optimize import brentq
    from scipy.stats import chi2, norm

    relative_errors = np.sqrt(chi2.ppf((np.arange(CHI_PARTS) + 0.5) / CHI_PARTS, dof) / dof)

    def power(difference: float) -> float:
        return float(
            np.mean(
                norm.sf(critical * relative_errors - difference) + norm.cdf(-critical * relative_errors - difference)
            )
        )

    return float(
        brentq(lambda difference: power(difference) - POWER, 0.0, critical * float(relative_errors[-1]) + 10.0)
    )
