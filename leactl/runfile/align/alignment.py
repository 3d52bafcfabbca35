"""Align one clock with another: offset, drift and their uncertainty, by least squares through common moments (ties).

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
NORMAL_95 = 1.959964
LEAST_DRIFT = 1e-12
# bound of a variance of correlated scores over that of uncorrelated ones; scores are a channel's noise times its own
# derivative, which cancel from sample to sample
LEAST_VARIANCE_SHARE = 0.05


class Tie(NamedTuple):
    """Time of one moment on both clocks."""

    device_time: float  # s
    run_time: float  # s
    sd: float  # s, of their difference


@dataclass(frozen=True)
class Alignment:
    """Straight line from a device's clock to the run's: run time = offset + rate * device time."""

    method: str
    offset: float  # s
    rate: float
    covariance: tuple[float, float, float]  # of offset and rate: s^2, s, 1; before `systematic`
    systematic: float  # s, 95 %: constant delay between the channels, which no tie shows
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
        """Return one line for people: offset and drift with their uncertainty at `device_time` [s], and the method."""
        drift = f", drift {self.drift_ppm:+.3g} +- {self.drift_uncertainty_ppm:.2g} ppm" if self.covariance[2] else ""
        run_time = float(self.on_run(np.array([device_time]))[0])
        when = f" at {device_time:.6g} s of its own" if device_time else ""
        within = f"+- {self.uncertainty(device_time):.2g} s (95 %)"
        return f"offset {run_time - device_time:.6g} {within}{when}{drift}, by {self.method}"

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
    shift = np.array([tie.run_time - tie.device_time for tie in ties])
    weight = 1.0 / np.array([tie.sd for tie in ties]) ** 2
    centre = float(np.average(device_times, weights=weight))
    centred = device_times - centre
    prior = (max(drift_within, LEAST_DRIFT) / NORMAL_95) ** -2
    normal = np.array(
        [
            [weight.sum(), (weight * centred).sum()],
            [(weight * centred).sum(), (weight * centred * centred).sum() + prior],
        ]
    )
    covariance = np.linalg.inv(normal)
    mean, slope = covariance @ np.array([(weight * shift).sum(), (weight * centred * shift).sum()])
    degrees_of_freedom = len(ties) - (2 if drift_within > LEAST_DRIFT else 1)
    quantile = NORMAL_95
    if degrees_of_freedom >= 1:
        from scipy.stats import t

        # a scatter above the standard deviations of the ties widens the interval; one below them is chance
        scatter = float((weight * (shift - mean - slope * centred) ** 2).sum()) / degrees_of_freedom
        covariance = covariance * max(scatter, 1.0)
        quantile = float(t.ppf(0.975, degrees_of_freedom)) if scatter > 1.0 else NORMAL_95
    at_zero = np.array([[1.0, -centre], [0.0, 1.0]])
    offset_row, rate_row = at_zero @ covariance @ at_zero.T
    return Alignment(
        method,
        float(mean - slope * centre),
        1.0 + float(slope),
        (offset_row[0], offset_row[1], rate_row[1]),
        systematic,
        quantile,
        len(ties),
    )


def autocorrelated_variance(scores: Array, least: float = LEAST_VARIANCE_SHARE) -> float:
    """Estimate the variance of the sum of correlated scores, after Newey and West (1987), with Bartlett weights.

    Parameters
    ----------
    least : lower bound, as a share of the variance that uncorrelated scores would have.
    """
    count = len(scores)
    lags = min(count - 1, 4 + int(4.0 * (count / 100.0) ** (2.0 / 9.0)))
    centred = scores - scores.mean()
    uncorrelated = total = float(centred @ centred)
    for lag in range(1, lags + 1):
        total += 2.0 * (1.0 - lag / (lags + 1.0)) * float(centred[lag:] @ centred[:-lag])
    return max(total, least * uncorrelated) * count / max(count - 3, 1)
