"""Estimates of many seeds against the true value: how often the interval holds it, and how far they lie from it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import Estimate

LEAST_COVERED, MOST_COVERED = 0.92, 0.98
WORST_ERROR = {  # relative, any seed
    "torque_constant": 0.005,
    "viscous_damping": 0.03,
    "coulomb_friction": 0.03,
    "back_emf_constant": 0.005,
    "line_to_line_constant": 0.005,
    "overshoot": 0.05,
    "settling_time": 0.05,
    "bandwidth": 0.05,
}


@dataclass(frozen=True)
class Judgement:
    """One result under one condition over all seeds."""

    name: str
    condition: str
    seeds: int
    covered: float  # share of seeds whose interval holds the true value
    mean_error: float  # of the size of the relative errors
    worst_error: float
    bias: float  # mean relative error, signed
    scatter: float  # standard deviation of the relative errors over the seeds
    printed: float  # root mean square of the standard uncertainties as printed, relative

    @property
    def faults(self) -> list[str]:
        """What a limit does not allow; results whose error has no limit have no faults."""
        return self.faults_of_coverage + self.faults_of_error if self.name in WORST_ERROR else []

    @property
    def faults_of_coverage(self) -> list[str]:
        """An interval that holds the true value too seldom or too often."""
        if LEAST_COVERED <= self.covered <= MOST_COVERED:
            return []
        allowed = f"{LEAST_COVERED:.0%} to {MOST_COVERED:.0%}"
        return [f"{self._place}: the interval holds the true value in {self.covered:.1%} of seeds, not {allowed}"]

    @property
    def faults_of_error(self) -> list[str]:
        """A seed that is further off than is allowed."""
        worst = WORST_ERROR.get(self.name, math.inf)
        if self.worst_error <= worst:
            return []
        return [f"{self._place}: the worst seed is off by {self.worst_error:.2%}, {worst:.1%} are allowed"]

    @property
    def _place(self) -> str:
        return f"{self.name}, {self.condition}"


def judge(name: str, condition: str, true: float | Sequence[float], estimates: Sequence[Estimate]) -> Judgement:
    """Compare the estimates of all seeds with the true value, one for all or one each; errors of zero are absolute."""
    trues = np.broadcast_to(np.asarray(true, float), len(estimates))
    values, stds, lows, highs = np.array([(item.value, item.std, item.low, item.high) for item in estimates]).T
    size = np.where(trues == 0.0, 1.0, np.abs(trues))
    errors = (values - trues) / size
    return Judgement(
        name=name,
        condition=condition,
        seeds=len(errors),
        covered=float(np.mean((lows <= trues) & (trues <= highs))),
        mean_error=float(np.mean(np.abs(errors))),
        worst_error=float(np.max(np.abs(errors))),
        bias=float(np.mean(errors)),
        scatter=float(np.std(errors, ddof=1)) if len(errors) > 1 else math.nan,
        printed=math.sqrt(float(np.mean((stds / size) ** 2))),
    )
