"""How a channel follows its demand: by which factor, and how closely, whatever the delay of the loop."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FEWEST_READINGS = 20  # with a demand
DEAD_GAIN = 0.1  # reading over demand, below which a channel does not follow; at its voltage limit a loop reaches more
FOLLOWING_CORRELATION = 0.5  # above which a channel follows its demand, by whatever factor
DECORRELATED = 0.5  # autocorrelation, below which a demand no longer resembles itself at that lag
UNIT_ERROR_FACTOR = 30.0  # reading over demand or the inverse: no loop is off so far, and a unit by a thousand


class SetpointTracking(NamedTuple):
    """Gain and correlation of a reading with its demand, at the delay at which they correlate best."""

    gain: float
    correlation: float

    @property
    def fault(self) -> str:
        """Return `opposite`, `unit` or `dead`; empty where the channel follows its demand."""
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
    The tracking; None with fewer than `FEWEST_READINGS` of both, without power in the demand (a constant, with
    `from_zero` only a demand of 0), or if the powers overflow.
    """
    both_finite = np.isfinite(demand) & np.isfinite(reading)
    demanded, read = demand[both_finite], reading[both_finite]
    if len(demanded) < FEWEST_READINGS:
        return None
    if not from_zero:
        demanded, read = demanded - demanded.mean(), read - read.mean()
    demand_power, reading_power = float(demanded @ demanded), float(read @ read)
    if demand_power <= 0.0 or not math.isfinite(demand_power * reading_power):
        return None
    size = 1 << (2 * len(demanded) - 1).bit_length()
    spectrum = np.fft.rfft(demanded, size)
    autocorrelation = np.fft.irfft(spectrum * np.conj(spectrum), size)[: len(demanded) // 4]
    decorrelated = np.flatnonzero(autocorrelation < DECORRELATED * autocorrelation[0])
    decorrelation_lag = max(int(decorrelated[0]) if len(decorrelated) else 1, 1)
    products = np.fft.irfft(np.fft.rfft(read, size) * np.conj(spectrum), size)[: 2 * decorrelation_lag]
    extreme = float(products[np.argmax(np.abs(products))])
    scale = math.sqrt(demand_power * reading_power)
    return SetpointTracking(extreme / demand_power, extreme / scale if scale > 0.0 else 0.0)
