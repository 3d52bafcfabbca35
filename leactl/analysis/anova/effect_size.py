"""Omega squared: the share of the variance that conditions explain, without what chance alone would explain.

Its interval follows from that of the noncentrality of F, lambda / (lambda + N) (Steiger, Psychological Methods 9,
2004).
"""

from collections.abc import Callable
from dataclasses import dataclass

from leactl.analysis.anova.one_way import FTest

MOST_NONCENTRALITY = 1e5  # above it the share is 1 to four digits for any number of values here


@dataclass(frozen=True)
class EffectSize:
    """Share of the variance that conditions explain, with its 95 % interval."""

    value: float
    low: float
    high: float


def omega_squared(test: FTest) -> EffectSize:
    """Estimate omega squared of a test, or its partial form if there is another factor; it is never below 0."""
    from scipy.stats import ncf

    count = test.between + test.within + 1.0
    excess = test.between * (test.f - 1.0)

    def lower_tail(noncentrality: float) -> float:
        return float(ncf.cdf(test.f, test.between, test.within, noncentrality))

    low, high = (_noncentrality(lower_tail, tail) for tail in (0.975, 0.025))
    return EffectSize(max(excess / (excess + count), 0.0), low / (low + count), high / (high + count))


def _noncentrality(lower_tail: Callable[[float], float], tail: float) -> float:
    """Return the noncentrality at which the lower tail of F has the probability `tail`; 0 if it is always less."""
    from scipy.optimize import brentq

    if lower_tail(1e-9) <= tail:
        return 0.0
    upper_bound = 1.0
    while lower_tail(upper_bound) > tail and upper_bound < MOST_NONCENTRALITY:
        upper_bound *= 2.0
    return (
        float(brentq(lambda noncentrality: lower_tail(noncentrality) - tail, 1e-9, upper_bound))
        if upper_bound < MOST_NONCENTRALITY
        else MOST_NONCENTRALITY
    )
