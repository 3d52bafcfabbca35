"""How a channel follows its demand: by which factor, and how closely, whatever the delay of the loop."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FEWEST = 20  # readings with a demand
DEAD = 0.1  # of the demand: a loop at its voltage limit still reaches more of it
CLOSE = 0.5  # correlation above which a channel follows, by whatever factor
UNIT = 30.0  # times the demand, above or below, that no loop does: a unit is off by a thousand


class Following(NamedTuple):
    """Gain and correlation of a reading with its demand, at the delay at which they correlate best."""

    gain: float
    correlation: float

    @property
    def fault(self) -> str:
        """Return `opposite`, `unit` or `dead`; empty where the channel follows its demand."""
        if self.correlation < -CLOSE and self.gain < -DEAD:
            return "opposite"
        if self.correlation > CLOSE and not 1.0 / UNIT <= self.gain <= UNIT:
            return "unit"
        return "dead" if abs(self.gain) < DEAD and self.correlation < CLOSE else ""


def following(demand: Array, reading: Array, from_zero: bool) -> Following | None:
    """Compare a reading with its demand, sample by sample; None where the demand does not move.

    `from_zero` says that the zero of both is the same, so that a constant demand can be compared too. Delays are tried
    up to where the demand has decorrelated: beyond, a wrong sign would look like half a wave of delay.
    """
    both_finite = np.isfinite(demand) & np.isfinite(reading)
    demanded, read = demand[both_finite], reading[both_finite]
    if len(demanded) < FEWEST:
        return None
    if not from_zero:
        demanded, read = demanded - demanded.mean(), read - read.mean()
    demand_power, reading_power = float(demanded @ demanded), float(read @ read)
    if demand_power <= 0.0 or not math.isfinite(demand_power * reading_power):
        return None
    size = 1 << (2 * len(demanded) - 1).bit_length()
    spectrum = np.fft.rfft(demanded, size)
    autocorrelation = np.fft.irfft(spectrum * np.conj(spectrum), size)[: len(demanded) // 4]
    decorrelated = np.flatnonzero(autocorrelation < CLOSE * autocorrelation[0])
    most_delay = max(int(decorrelated[0]) if len(decorrelated) else 1, 1)
    products = np.fft.irfft(np.fft.rfft(read, size) * np.conj(spectrum), size)[: 2 * most_delay]
    extreme = float(products[np.argmax(np.abs(products))])
    scale = math.sqrt(demand_power * reading_power)
    return Following(extreme / demand_power, extreme / scale if scale > 0.0 else 0.0)
