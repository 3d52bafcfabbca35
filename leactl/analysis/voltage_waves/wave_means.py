"""Means over waves with their uncertainty: scatter, drift, differences between holds, and common errors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leactl.analysis.estimate import Estimate
from leactl.analysis.signals.levels import standard_error
from leactl.analysis.statistics.intervals import half_width
from leactl.analysis.statistics.regression import POOLING_P_VALUE
from leactl.analysis.voltage_waves.waves import Array

LEAST_DRIFT_ERRORS = 5.0  # standard errors of a drift; a smaller one may be chance
LEAST_DRIFT = 1e-3  # of the mean, over a hold


@dataclass(frozen=True)
class CommonUncertainties:
    """Relative standard uncertainties that do not average out over waves."""

    scale: float  # of the converter, the same for all channels
    time_base: float
    resolution: float  # rounding, where every wave rounds alike
    ripple: float = 0.0  # of the speed, twice a wave; it affects single pairs only

    @property
    def of_one_pair(self) -> "CommonUncertainties":
        """Return the uncertainties of a single pair: a ripple of the speed adds up to a quarter, by its phase."""
        return replace(self, resolution=math.hypot(self.resolution, self.ripple / 4.0 / math.sqrt(2.0)))

    @property
    def between_pairs(self) -> "CommonUncertainties":
        """Return the uncertainties of a single pair without those that all pairs have in common."""
        return replace(self.of_one_pair, scale=0.0, time_base=0.0)

    @property
    def of_time(self) -> "CommonUncertainties":
        """Return the uncertainties of a frequency: that of the time base alone."""
        return CommonUncertainties(0.0, self.time_base, 0.0)

    @property
    def scale_and_rounding(self) -> float:
        """Return scale and rounding added in squares; the time base has a uniform distribution and is not in it."""
        return math.hypot(self.scale, self.resolution)


def constant_of(name: str, units: str, series: Sequence[Array], shares: CommonUncertainties) -> Estimate:
    """Estimate a constant from the waves of every hold, with its 95 % interval."""
    value, scatter_std, dof = mean_over_holds(series)
    std_without_time_base = math.hypot(scatter_std, shares.scale_and_rounding * value)
    effective = (
        dof * (std_without_time_base / scatter_std) ** 4 if scatter_std > 1e-9 * std_without_time_base else math.inf
    )
    half = half_width(std_without_time_base, effective, math.sqrt(3.0) * shares.time_base * value)
    std = math.hypot(std_without_time_base, shares.time_base * value)
    return Estimate(name, value, std, value - half, value + half, units)


def mean_over_holds(series: Sequence[Array]) -> tuple[float, float, float]:
    """Average over holds; return mean, standard error and degrees of freedom.

    The standard error follows from the scatter between holds where that is more than the holds' uncertainties explain.
    """
    means = np.array([float(np.nanmean(hold_values)) for hold_values in series])
    errors = np.array(
        [math.hypot(standard_error(hold_values), drift_of(hold_values) / math.sqrt(12.0)) for hold_values in series]
    )
    count = len(series)
    within = math.sqrt(float(np.sum(errors**2))) / count
    dof = float(sum(np.isfinite(hold_values).sum() - 1 for hold_values in series))
    if count == 1 or not (errors > 0.0).all():
        return float(means.mean()), within, dof
    from scipy.special import chdtrc

    between = float(np.std(means, ddof=1)) / math.sqrt(count)
    probability = float(chdtrc(count - 1, float(np.sum(((means - means.mean()) / errors) ** 2))))
    if probability > POOLING_P_VALUE or between <= within:
        return float(means.mean()), within, dof
    return float(means.mean()), between, count - 1.0


def drift_of(series: Array) -> float:
    """Return the change of a hold's waves from first to last along a straight line; 0 if it is not clear, or small."""
    finite = np.isfinite(series)
    values = series[finite]
    count = len(values)
    if count < 5:
        return 0.0
    position = np.flatnonzero(finite) / (len(series) - 1.0) - 0.5
    position = position - position.mean()
    slope = float(position @ values) / float(position @ position)
    residuals = values - values.mean() - slope * position
    error = math.sqrt(float(residuals @ residuals) / (count - 2) / float(position @ position))
    return slope if abs(slope) > max(LEAST_DRIFT_ERRORS * error, LEAST_DRIFT * abs(float(values.mean()))) else 0.0
