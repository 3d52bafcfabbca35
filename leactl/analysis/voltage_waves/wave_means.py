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

LEAST_DRIFT_ERRORS = 5.0  # standard errors of a drift; a smaller drift may be chance
LEAST_DRIFT = 1e-3  # of the mean, over a hold; a smaller drift does not count


@dataclass(frozen=True)
class CommonUncertainties:
    """Relative standard uncertainties that the mean over waves does not reduce."""

    scale: float  # of the converter, the same for all channels
    time_base: float
    resolution: float  # by rounding, if every wave rounds alike
    ripple: float = 0.0  # amplitude of the speed's ripple at twice a wave; it affects single pairs only

    @property
    def of_one_pair(self) -> "CommonUncertainties":
        """Return the uncertainties of a single pair: a ripple of the speed adds up to a quarter of it, by its phase."""
        return replace(self, resolution=math.hypot(self.resolution, self.ripple / 4.0 / math.sqrt(2.0)))

    @property
    def between_pairs(self) -> "CommonUncertainties":
        """Return the uncertainties of a single pair without those that all pairs share."""
        return replace(self.of_one_pair, scale=0.0, time_base=0.0)

    @property
    def of_time(self) -> "CommonUncertainties":
        """Return the uncertainties of a frequency: that of the time base alone."""
        return CommonUncertainties(0.0, self.time_base, 0.0)

    @property
    def scale_and_rounding(self) -> float:
        """Return scale and rounding added in squares, without the time base, whose error is uniformly distributed."""
        return math.hypot(self.scale, self.resolution)


def constant_of(
    name: str, units: str, values_by_hold: Sequence[Array], common_uncertainties: CommonUncertainties
) -> Estimate:
    """Estimate a constant from its values of the waves of every hold, shape (waves,) each."""
    value, scatter_std, dof = mean_over_holds(values_by_hold)
    std_without_time_base = math.hypot(scatter_std, common_uncertainties.scale_and_rounding * value)
    effective_dof = (
        dof * (std_without_time_base / scatter_std) ** 4 if scatter_std > 1e-9 * std_without_time_base else math.inf
    )
    interval_half_width = half_width(
        std_without_time_base, effective_dof, math.sqrt(3.0) * common_uncertainties.time_base * value
    )
    std = math.hypot(std_without_time_base, common_uncertainties.time_base * value)
    return Estimate(name, value, std, value - interval_half_width, value + interval_half_width, units)


def mean_over_holds(values_by_hold: Sequence[Array]) -> tuple[float, float, float]:
    """Return the mean over holds, its standard error and its degrees of freedom.

    The standard error follows from the scatter between holds if that is more than the holds' uncertainties explain.
    """
    means = np.array([float(np.nanmean(hold_values)) for hold_values in values_by_hold])
    hold_errors = np.array(
        [
            math.hypot(standard_error(hold_values), drift_of(hold_values) / math.sqrt(12.0))
            for hold_values in values_by_hold
        ]
    )
    hold_count = len(values_by_hold)
    error_within_holds = math.sqrt(float(np.sum(hold_errors**2))) / hold_count
    dof = float(sum(np.isfinite(hold_values).sum() - 1 for hold_values in values_by_hold))
    if hold_count == 1 or not (hold_errors > 0.0).all():
        return float(means.mean()), error_within_holds, dof
    from scipy.special import chdtrc

    error_between_holds = float(np.std(means, ddof=1)) / math.sqrt(hold_count)
    probability = float(chdtrc(hold_count - 1, float(np.sum(((means - means.mean()) / hold_errors) ** 2))))
    if probability > POOLING_P_VALUE or error_between_holds <= error_within_holds:
        return float(means.mean()), error_within_holds, dof
    return float(means.mean()), error_between_holds, hold_count - 1.0


def drift_of(wave_values: Array) -> float:
    """Return the change of a hold's values from first to last wave along a line; 0 if it may be chance or is small."""
    finite = np.isfinite(wave_values)
    values = wave_values[finite]
    count = len(values)
    if count < 5:
        return 0.0
    position = np.flatnonzero(finite) / (len(wave_values) - 1.0) - 0.5
    position = position - position.mean()
    slope = float(position @ values) / float(position @ position)
    residuals = values - values.mean() - slope * position
    slope_error = math.sqrt(float(residuals @ residuals) / (count - 2) / float(position @ position))
    return slope if abs(slope) > max(LEAST_DRIFT_ERRORS * slope_error, LEAST_DRIFT * abs(float(values.mean()))) else 0.0
