"""Estimates of many seeds against the true value: how often the interval holds it, and how far they lie from it."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

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
        """What a limit does not allow; results that have no limit have no faults."""
        worst = WORST_ERROR.get(self.name)
        if worst is None:
            return []
        place = f"{self.name}, {self.condition}"
        faults = []
        if not LEAST_COVERED <= self.covered <= MOST_COVERED:
            allowed = f"{LEAST_COVERED:.0%} to {MOST_COVERED:.0%}"
            faults.append(f"{place}: the interval holds the true value in {self.covered:.1%} of seeds, not {allowed}")
        if not self.worst_error <= worst:
            faults.append(f"{place}: the worst seed is off by {self.worst_error:.2%}, {worst:.1%} are allowed")
        return faults


def judge(name: str, condition: str, true: float | Sequence[float], estimates: Sequence[Estimate]) -> Judgement:
    """Compare the estimates of all seeds with the true value, one for all or one each; errors of zero are absolute."""
    trues = [true] * len(estimates) if isinstance(true, int | float) else list(true)
    size = [abs(value) or 1.0 for value in trues]
    errors = [(item.value - value) / unit for item, value, unit in zip(estimates, trues, size, strict=True)]
    return Judgement(
        name=name,
        condition=condition,
        seeds=len(errors),
        covered=sum(item.low <= value <= item.high for item, value in zip(estimates, trues, strict=True)) / len(errors),
        mean_error=statistics.fmean(abs(error) for error in errors),
        worst_error=max(abs(error) for error in errors),
        bias=statistics.fmean(errors),
        scatter=statistics.stdev(errors) if len(errors) > 1 else math.nan,
        printed=math.sqrt(statistics.fmean((item.std / unit) ** 2 for item, unit in zip(estimates, size, strict=True))),
    )
