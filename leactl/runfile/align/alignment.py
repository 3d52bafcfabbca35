"""Align one clock with another by least squares through common moments (ties): offset, drift and their uncertainty.

A tie is one moment with its time on both clocks and its standard deviation. The alignment is a straight line through
the ties. The drift of one clock against the other has a known bound, which enters as a prior on the slope, so that the
uncertainty of a single tie grows with the time from it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
NORMAL_95 = 1.959964  # 97.5 % quantile of the normal distribution
SMALLEST_DRIFT_BOUND = 1e-12  # relative; a smaller bound counts as this one, so that its weight stays finite
# lower bound of the variance of the scores' sum, as a share of that without correlation; scores are a channel's noise
# times its own derivative and nearly cancel from sample to sample, so that an estimate may come out near zero
LEAST_VARIANCE_SHARE = 0.05


class Tie(NamedTuple):
    """Time of one moment on both clocks."""

    device_time: float  # s
    run_time: float  # s
    sd: float  # s, standard deviation of the difference of both times


@dataclass(frozen=True)
class Alignment:
    """Straight line from a device's clock to the run's: run time = offset + rate * device time."""

    method: str
    offset: float  # s
    rate: float
    covariance: tuple[float, float, float]  # offset variance [s^2], covariance [s], rate variance; without `systematic`
    systematic: float  # s, 95 % bound of a constant delay between the channels, which no tie shows
    quantile: float  # factor from standard deviation to the half-width of the 95 % interval
    ties: int  # number of ties

    def on_run(self, device_time: Array) -> Array:
        """Convert stamps of the device's clock [s], any shape, to the run's clock [s]."""
        return np.asarray(self.offset + self.rate * device_time, np.float64)

    def uncertainty(self, device_time: float) -> float:
        """Return the half-width of the 95 % interval [s] of a stamp converted to the run's clock."""
        offset_variance, covariance, rate_variance = self.covariance
        return math.hypot(
            self.quantile
            * math.sqrt(
                max(offset_variance + 2 * device_time * covariance + device_time * device_time * rate_variance, 0.0)
            ),
            self.systematic,
        )

    def describe(self, device_time: float = 0.0) -> str:
        """Return one line for people: offset at `device_time` [s] and drift, both with uncertainty, and the method."""
        drift_text = (
            f", drift {self.drift_ppm:+.3g} +- {self.drift_uncertainty_ppm:.2g} ppm" if self.covariance[2] else ""
        )
        run_time = float(self.on_run(np.array([device_time]))[0])
        time_text = f" at {device_time:.6g} s of its own" if device_time else ""
        uncertainty_text = f"+- {self.uncertainty(device_time):.2g} s (95 %)"
        return f"offset {run_time - device_time:.6g} {uncertainty_text}{time_text}{drift_text}, by {self.method}"

    @property
    def drift_ppm(self) -> float:
        """Rate of the run's clock over the device's, minus one [ppm]."""
        return 1e6 * (self.rate - 1.0)

    @property
    def drift_uncertainty_ppm(self) -> float:
        """Half-width of the 95 % interval of the drift [ppm]."""
        return 1e6 * self.quantile * math.sqrt(max(self.covariance[2], 0.0))


def fit_alignment(method: str, ties: Sequence[Tie], drift_within: float, systematic: float) -> Alignment:
    """Fit the line through ties by weighted least squares, with the bound of the drift as prior on its slope.

    Parameters
    ----------
    drift_within : prior of the rate: within 1 +- `drift_within` (95 %).
    systematic : constant delay between the two channels that the ties compare (95 %) [s].
    """
    device_times = np.array([tie.device_time for tie in ties])
    clock_differences = np.array([tie.run_time - tie.device_time for tie in ties])
    weights = 1.0 / np.array([tie.sd for tie in ties]) ** 2
    mean_time = float(np.average(device_times, weights=weights))
    centred_times = device_times - mean_time
    prior_weight = (max(drift_within, SMALLEST_DRIFT_BOUND) / NORMAL_95) ** -2
    normal_matrix = np.array(
        [
            [weights.sum(), (weights * centred_times).sum()],
            [(weights * centred_times).sum(), (weights * centred_times * centred_times).sum() + prior_weight],
        ]
    )
    covariance = np.linalg.inv(normal_matrix)
    mean_difference, slope = covariance @ np.array(
        [(weights * clock_differences).sum(), (weights * centred_times * clock_differences).sum()]
    )
    degrees_of_freedom = len(ties) - (2 if drift_within > SMALLEST_DRIFT_BOUND else 1)
    quantile = NORMAL_95
    if degrees_of_freedom >= 1:
        from scipy.stats import t

        # more scatter than the ties' standard deviations widens the interval; less scatter is chance and does not count
        scatter = (
            float((weights * (clock_differences - mean_difference - slope * centred_times) ** 2).sum())
            / degrees_of_freedom
        )
        covariance = covariance * max(scatter, 1.0)
        quantile = float(t.ppf(0.975, degrees_of_freedom)) if scatter > 1.0 else NORMAL_95
    to_time_zero = np.array([[1.0, -mean_time], [0.0, 1.0]])
    offset_row, rate_row = to_time_zero @ covariance @ to_time_zero.T
    return Alignment(
        method,
        float(mean_difference - slope * mean_time),
        1.0 + float(slope),
        (offset_row[0], offset_row[1], rate_row[1]),
        systematic,
        quantile,
        len(ties),
    )


def autocorrelated_variance(scores: Array, least_share: float = LEAST_VARIANCE_SHARE) -> float:
    """Estimate the variance of the sum of correlated scores, after Newey and West (1987), with Bartlett weights.

    Parameters
    ----------
    least_share : lower bound, as a share of the variance that uncorrelated scores would have.
    """
    count = len(scores)
    lags = min(count - 1, 4 + int(4.0 * (count / 100.0) ** (2.0 / 9.0)))
    centred_scores = scores - scores.mean()
    uncorrelated = total = float(centred_scores @ centred_scores)
    for lag in range(1, lags + 1):
        total += 2.0 * (1.0 - lag / (lags + 1.0)) * float(centred_scores[lag:] @ centred_scores[:-lag])
    return max(total, least_share * uncorrelated) * count / max(count - 3, 1)
