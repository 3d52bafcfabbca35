"""Means over waves with their whole uncertainty: scatter, drift, holds that differ, and what every wave shares."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leactl.analysis.estimate import Estimate
from leactl.analysis.signals.levels import standard_error
from leactl.analysis.statistics.intervals import half_width
from leactl.analysis.statistics.regression import POOLED_ABOVE
from leactl.analysis.voltage_waves.waves import Array

CLEAR = 5.0  # standard errors, above which a drift is one
DRIFTS = 1e-3  # of the mean, over a hold


@dataclass(frozen=True)
class CommonUncertainties:
    """Relative standard uncertainties that no number of waves averages out."""

    scale: float  # of the converter, the same for all channels
    time_base: float
    resolution: float  # rounding, where every wave rounds alike
    ripple: float = 0.0  # of the speed, twice a wave; only single pairs know it

    @property
    def of_one_pair(self) -> "CommonUncertainties":
        """With what ripple does to a pair: up to a quarter of it, by its phase."""
        return replace(self, resolution=math.hypot(self.resolution, self.ripple / 4.0 / math.sqrt(2.0)))

    @property
    def between_pairs(self) -> "CommonUncertainties":
        """Without what pairs share."""
        return replace(self.of_one_pair, scale=0.0, time_base=0.0)

    @property
    def of_time(self) -> "CommonUncertainties":
        """Of a frequency."""
        return CommonUncertainties(0.0, self.time_base, 0.0)

    @property
    def scattered(self) -> float:
        """Of scale and rounding, in squares; the time base is evenly spread, and counts by itself."""
        return math.hypot(self.scale, self.resolution)


def constant_of(name: str, units: str, series: Sequence[Array], shares: CommonUncertainties) -> Estimate:
    """One number from the waves of every hold, with its 95 % interval."""
    value, own, dof = pooled(series)
    scattered = math.hypot(own, shares.scattered * value)
    effective = dof * (scattered / own) ** 4 if own > 1e-9 * scattered else math.inf
    half = half_width(scattered, effective, math.sqrt(3.0) * shares.time_base * value)
    std = math.hypot(scattered, shares.time_base * value)
    return Estimate(name, value, std, value - half, value + half, units)


def pooled(series: Sequence[Array]) -> tuple[float, float, float]:
    """Mean over holds, its standard error, and the degrees of freedom of that; holds that differ judge themselves."""
    means = np.array([float(np.nanmean(item)) for item in series])
    errors = np.array([math.hypot(standard_error(item), drift_of(item) / math.sqrt(12.0)) for item in series])
    count = len(series)
    within = math.sqrt(float(np.sum(errors**2))) / count
    dof = float(sum(np.isfinite(item).sum() - 1 for item in series))
    if count == 1 or not (errors > 0.0).all():
        return float(means.mean()), within, dof
    from scipy.special import chdtrc

    between = float(np.std(means, ddof=1)) / math.sqrt(count)
    chance = float(chdtrc(count - 1, float(np.sum(((means - means.mean()) / errors) ** 2))))
    if chance > POOLED_ABOVE or between <= within:
        return float(means.mean()), within, dof
    return float(means.mean()), between, count - 1.0


def drift_of(series: Array) -> float:
    """Change of the waves from first to last along a straight line; 0 where it is not clear, or small."""
    good = np.isfinite(series)
    values = series[good]
    count = len(values)
    if count < 5:
        return 0.0
    place = np.flatnonzero(good) / (len(series) - 1.0) - 0.5
    place = place - place.mean()
    slope = float(place @ values) / float(place @ place)
    rest = values - values.mean() - slope * place
    error = math.sqrt(float(rest @ rest) / (count - 2) / float(place @ place))
    return slope if abs(slope) > max(CLEAR * error, DRIFTS * abs(float(values.mean()))) else 0.0
