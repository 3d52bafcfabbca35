"""Noise and rounding of a channel, estimated from its own samples."""

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

Array = npt.NDArray[np.float64]
SEGMENT = 64  # samples of one spectrum
LINE_FILTER_BINS = 9  # bins of the median filter that removes lines from a spectrum
TREND_COEFFICIENTS = 4  # of the cubic that is removed from a segment as motion, with the noise of as many bins
MEDIAN_OF_POWER = float(np.log(2.0))  # median over mean of the power of white noise in a bin


def noise_of(values: Array, quantum: float | None = None) -> float:
    """Return the standard deviation of a channel's noise from its third differences, at least that of quantisation."""
    if len(values) < 8:
        return 0.0
    # 0.6745: median of absolute values over standard deviation of normal noise; 20: variance of a third difference over
    # that of a sample
    rough = float(np.median(np.abs(np.diff(values, 3))) / (0.6745 * np.sqrt(20.0)))
    return float(max(rough, (quantum if quantum is not None else quantum_of(values)) / np.sqrt(12.0)))


def quantum_of(values: Array) -> float:
    """Return the smallest step between two values of a channel; zero if nearly all of its values differ."""
    levels = np.unique(values[: 1 << 14])
    if len(levels) < 2 or len(levels) > 0.9 * min(len(values), 1 << 14):
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * float(np.max(np.abs(levels)))]
    return float(np.min(steps)) if len(steps) else 0.0


def coloured_noise(values: Array, quantum: float, random: np.random.Generator) -> Array:
    """Return random noise with a channel's quiet spectrum, less the power of rounding."""
    power = quiet_spectrum(values)
    if power is None:
        return np.zeros(len(values))
    power = np.maximum(power - quantum**2 / 12.0, 0.0)
    white = np.fft.rfft(random.standard_normal(len(values)))
    bins = np.linspace(0.0, 1.0, len(white)) * (len(power) - 1)
    return np.asarray(np.fft.irfft(white * np.sqrt(np.interp(bins, np.arange(len(power)), power)), len(values)))


def quiet_spectrum(values: Array) -> Array | None:
    """Return the noise power of a channel in each bin, scaled so that white noise has its variance; None if too short.

    The median over segments removes occasional motion, the median over bins removes lines. Below a quarter of the band
    motion and noise cannot be separated: noise is taken to be no higher there than in the quarter above. In the lowest
    bins, which the removed trend empties, it is as in the rest of that quarter.
    """
    count = len(values) // SEGMENT
    if count < 3:
        return None
    segments = values[: count * SEGMENT].reshape(count, SEGMENT)
    positions = np.linspace(-1.0, 1.0, SEGMENT)
    basis = np.linalg.qr(np.stack([positions**power for power in range(TREND_COEFFICIENTS)], axis=1))[0]
    window = np.hanning(SEGMENT)
    spectra = np.abs(np.fft.rfft((segments - segments @ basis @ basis.T) * window, axis=1)) ** 2 / np.sum(window**2)
    power = np.median(spectra, axis=0) / MEDIAN_OF_POWER
    quarter_band, half_band = len(power) // 4, len(power) // 2
    power[:TREND_COEFFICIENTS] = np.median(power[TREND_COEFFICIENTS:quarter_band])
    power = np.asarray(median_filter(power, LINE_FILTER_BINS, mode="nearest"))
    power[:quarter_band] = np.minimum(power[:quarter_band], np.median(power[quarter_band:half_band]))
    return power
