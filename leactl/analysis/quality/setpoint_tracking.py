"""How a channel follows its demand: by which factor and how closely, at any delay of the loop."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FEWEST_READINGS = 20  # that have a demand
DEAD_GAIN = 0.1  # reading over demand; with less, a channel does not follow. A loop at its voltage limit reaches more
FOLLOWING_CORRELATION = 0.5  # a channel with more follows its demand, by any factor
DECORRELATED = 0.5  # autocorrelation; at a lag with less, a demand no longer resembles itself
UNIT_ERROR_FACTOR = 30.0  # reading over demand or the inverse: no loop is off by so much, but a unit is by a thousand


class SetpointTracking(NamedTuple):
    """Gain and correlation of a reading with its demand, at the delay at which they correlate best."""

    gain: float
    correlation: float

    @property
    def fault(self) -> str:
        """Return `opposite`, `unit` or `dead`; empty if the channel has none of these faults."""
        if self.correlation < -FOLLOWING_CORRELATION and self.gain < -DEAD_GAIN:
            return "opposite"
        if self.correlation > FOLLOWING_CORRELATION and not 1.0 / UNIT_ERROR_FACTOR <= self.gain <= UNIT_ERROR_FACTOR:
            return "unit"
        return "dead" if abs(self.gain) < DEAD_GAIN and self.correlation < FOLLOWING_CORRELATION else ""


def compare_with_demand(demand: Array, reading: Array, from_zero: bool) -> SetpointTracking | None:
    """Return how a reading tracks its demand; None if they cannot be compared.

    The delay is searched from 0 to twice the lag at which the demand's autocorrelation falls below `DECORRELATED`: at
    longer delays, a wrong sign would look like half a wave of delay.

    Parameters
    ----------
    demand, reading : same shape (readings,); NaN where either is missing.
    from_zero : whether the zero of both is the same, so that a constant demand can be compared too; else their means
        are subtracted.

    Returns
    -------
    The tracking; None if fewer than `FEWEST_READINGS` have both, if the demand has no power (it is constant, or with
    `from_zero` it is 0), or if the powers overflow.
    """
    both_finite = np.isfinite(demand) & np.isfinite(reading)
    demand_values, read_values = demand[both_finite], reading[both_finite]
    if len(demand_values) < FEWEST_READINGS:
        return None
    if not from_zero:
        demand_values, read_values = demand_values - demand_values.mean(), read_values - read_values.mean()
    demand_power, reading_power = float(demand_values @ demand_values), float(read_values @ read_values)
    if demand_power <= 0.0 or not math.isfinite(demand_power * reading_power):
        return None
    fft_size = 1 << (2 * len(demand_values) - 1).bit_length()
    spectrum = np.fft.rfft(demand_values, fft_size)
    autocorrelation = np.fft.irfft(spectrum * np.conj(spectrum), fft_size)[: len(demand_values) // 4]
    decorrelated_lags = np.flatnonzero(autocorrelation < DECORRELATED * autocorrelation[0])
    decorrelation_lag = max(int(decorrelated_lags[0]) if len(decorrelated_lags) else 1, 1)
    products = np.fft.irfft(np.fft.rfft(read_values, fft_size) * np.conj(spectrum), fft_size)[: 2 * decorrelation_lag]
    extreme_product = float(products[np.argmax(np.abs(products))])
    scale = math.sqrt(demand_power * reading_power)
    return SetpointTracking(extreme_product / demand_power, extreme_product / scale if scale > 0.0 else 0.0)
