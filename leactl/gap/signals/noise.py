"""What a channel shows of its own noise and rounding."""

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

Array = npt.NDArray[np.float64]
SEGMENT = 64  # samples, over which a channel's noise shows its colour
LINES = 9  # bins of its spectrum, of which one line is no noise
TREND = 4  # coefficients of the cubic that motion is in a segment; noise in as many bins goes with it
MEDIAN_OF_POWER = float(np.log(2.0))  # of a bin of white noise, over its mean


def noise_of(values: Array, quantum: float | None = None) -> float:
    """Standard deviation of a channel's noise from its third differences, at least that of its quantisation."""
    if len(values) < 8:
        return 0.0
    rough = float(np.median(np.abs(np.diff(values, 3))) / (0.6745 * np.sqrt(20.0)))
    return float(max(rough, (quantum if quantum is not None else quantum_of(values)) / np.sqrt(12.0)))


def quantum_of(values: Array) -> float:
    """Smallest step between two values of a channel, zero where every value is another."""
    levels = np.unique(values[: 1 << 14])
    if len(levels) < 2 or len(levels) > 0.9 * min(len(values), 1 << 14):
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * float(np.max(np.abs(levels)))]
    return float(np.min(steps)) if len(steps) else 0.0


def coloured(values: Array, quantum: float, random: np.random.Generator) -> Array:
    """Noise with the spectrum that a channel has in its quieter half, without lines and without rounding's share."""
    power = quiet_spectrum(values)
    if power is None:
        return np.zeros(len(values))
    power = np.maximum(power - quantum**2 / 12.0, 0.0)
    white = np.fft.rfft(random.standard_normal(len(values)))
    at = np.linspace(0.0, 1.0, len(white)) * (len(power) - 1)
    return np.asarray(np.fft.irfft(white * np.sqrt(np.interp(at, np.arange(len(power)), power)), len(values)))


def quiet_spectrum(values: Array) -> Array | None:
    """Power of a channel's noise in each bin, as white noise of that variance would have it; None of too few samples.

    The median over segments leaves out what moves the channel now and then, that over bins what repeats. Below a
    quarter of the band motion and noise do not part: noise is taken to be no higher there than in the quarter above.
    In the lowest bins, of which the segment's trend leaves nothing, it is as in the rest of that quarter.
    """
    count = len(values) // SEGMENT
    if count < 3:
        return None
    parts = values[: count * SEGMENT].reshape(count, SEGMENT)
    at = np.linspace(-1.0, 1.0, SEGMENT)
    basis = np.linalg.qr(np.stack([at**power for power in range(TREND)], axis=1))[0]
    window = np.hanning(SEGMENT)
    spectra = np.abs(np.fft.rfft((parts - parts @ basis @ basis.T) * window, axis=1)) ** 2 / np.sum(window**2)
    power = np.median(spectra, axis=0) / MEDIAN_OF_POWER
    quarter, half = len(power) // 4, len(power) // 2
    power[:TREND] = np.median(power[TREND:quarter])
    power = np.asarray(median_filter(power, LINES, mode="nearest"))
    power[:quarter] = np.minimum(power[:quarter], np.median(power[quarter:half]))
    return power
