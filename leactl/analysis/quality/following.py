"""How a channel follows its demand: by which factor, and how closely, whatever the delay of the loop."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FEWEST = 20  # readings with a demand
DEAD = 0.1  # of the demand: a loop at its voltage limit reaches more of it
CLOSE = 0.5  # correlation above which a channel follows, by whatever factor
UNIT = 30.0  # times the demand, above or below, that no loop does: a unit is off by a thousand


class Following(NamedTuple):
    """Reading over demand, as a factor and as a correlation, at the delay at which they are most alike."""

    gain: float
    correlation: float

    @property
    def fault(self) -> str:
        """What is wrong with the channel; empty where it follows its demand."""
        if self.correlation < -CLOSE and self.gain < -DEAD:
            return "opposite"
        if self.correlation > CLOSE and not 1.0 / UNIT <= self.gain <= UNIT:
            return "unit"
        return "dead" if abs(self.gain) < DEAD and self.correlation < CLOSE else ""


def following(demand: Array, reading: Array, from_zero: bool) -> Following | None:
    """Compare a reading with its demand, sample by sample; None where the demand tells nothing.

    `from_zero` says that the zero of both is the same, so that a demand that never moves tells too. Delays are tried up
    to where the demand has become another: beyond, a turned sign would look like half a wave of delay.
    """
    good = np.isfinite(demand) & np.isfinite(reading)
    wanted, seen = demand[good], reading[good]
    if len(wanted) < FEWEST:
        return None
    if not from_zero:
        wanted, seen = wanted - wanted.mean(), seen - seen.mean()
    power, answered = float(wanted @ wanted), float(seen @ seen)
    if power <= 0.0 or not math.isfinite(power * answered):
        return None
    size = 1 << (2 * len(wanted) - 1).bit_length()
    spectrum = np.fft.rfft(wanted, size)
    alike = np.fft.irfft(spectrum * np.conj(spectrum), size)[: len(wanted) // 4]
    changed = np.flatnonzero(alike < CLOSE * alike[0])
    delays = max(int(changed[0]) if len(changed) else 1, 1)
    products = np.fft.irfft(np.fft.rfft(seen, size) * np.conj(spectrum), size)[: 2 * delays]
    best = float(products[np.argmax(np.abs(products))])
    scale = math.sqrt(power * answered)
    return Following(best / power, best / scale if scale > 0.0 else 0.0)
