"""Frequency response from noise by Blackman and Tukey: windowed covariances, transformed.

Ljung, System Identification, 2nd ed. (1999), section 6.4; Jenkins & Watts, Spectral Analysis and Its Applications
(1968), chapter 10, for coherence and the variance of the gain. The window is Hann's, over lags to both sides. It
averages the response over neighbouring frequencies. The error of this average is estimated by averaging once more, and
subtracted (Tukey's twicing).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.analysis.statistics.regression import Array

Complex = npt.NDArray[np.complex128]
Mask = npt.NDArray[np.bool_]
POINTS_PER_RESOLUTION = 4  # of the grid of frequencies, in the distance that the window resolves


class Spectra(NamedTuple):
    """Sums over records of the transformed covariances of input and output, shape (frequencies,) each."""

    input: Array
    output: Array
    cross: Complex
    samples: int

    def plus(self, other: "Spectra", sign: int = 1) -> "Spectra":
        """Return the spectra with the records of `other` added, or taken out if `sign` is -1."""
        return Spectra(
            self.input + sign * other.input,
            self.output + sign * other.output,
            self.cross + sign * other.cross,
            self.samples + sign * other.samples,
        )


def sum_of_spectra(spectra: Sequence[Spectra]) -> Spectra:
    """Return the spectra of all records together."""
    return reduce(Spectra.plus, spectra)


@dataclass(frozen=True, eq=False)
class BlackmanTukey:
    """Estimator of frequency responses for records of one rate."""

    interval: float  # s, between samples
    lags: int  # of the window, to either side
    highest_frequency: float  # Hz

    @property
    def resolution(self) -> float:
        """Return the distance [Hz] between frequencies that the window resolves."""
        return 1.0 / (2 * self.lags * self.interval)

    @property
    def frequency(self) -> Array:
        """Return the grid of frequencies [Hz], which exceeds the highest by one resolution for the correction."""
        count = round(self.highest_frequency / self.resolution * POINTS_PER_RESOLUTION) + POINTS_PER_RESOLUTION + 1
        return np.asarray(self.resolution / POINTS_PER_RESOLUTION * np.arange(count), np.float64)

    @property
    def window(self) -> Array:
        """Return Hann's window over the lags from -`lags` to `lags`, shape (2 `lags` + 1,)."""
        lag = np.arange(-self.lags, self.lags + 1)
        return np.asarray(0.5 * (1.0 + np.cos(math.pi * lag / self.lags)), np.float64)

    def spectra(self, reference: Array, measured: Array) -> Spectra:
        """Return the spectra of one record, after subtraction of its means; both arguments have shape (samples,)."""
        reference, measured = reference - reference.mean(), measured - measured.mean()
        fft_size = 1 << (2 * len(reference) - 1).bit_length()
        u, y = np.fft.rfft(reference, fft_size), np.fft.rfft(measured, fft_size)
        lag = np.arange(-self.lags, self.lags + 1)
        kernel = np.exp(-2j * math.pi * self.interval * np.outer(self.frequency, lag))
        transforms = [
            kernel @ (self.window * np.fft.irfft(product, fft_size)[lag])
            for product in (u.conj() * u, y.conj() * y, u.conj() * y)
        ]
        return Spectra(transforms[0].real, transforms[1].real, transforms[2], len(reference))

    def response(self, spectra: Spectra) -> "Response":
        """Return the corrected response and its coherence, up to the highest frequency."""
        raw_response = spectra.cross / spectra.input
        power = spectra.input * spectra.output
        # a response without power, such as that of a sensor that stands still, has no coherence
        coherence = np.divide(np.abs(spectra.cross) ** 2, power, out=np.zeros_like(power), where=power > 0.0)
        # the response at negative frequencies is the conjugate of that at positive ones
        mirrored = np.concatenate([raw_response[POINTS_PER_RESOLUTION:0:-1].conj(), raw_response])
        count = len(raw_response) - POINTS_PER_RESOLUTION
        averaged_response = 0.5 * raw_response[:count] + 0.25 * (
            mirrored[:count] + mirrored[2 * POINTS_PER_RESOLUTION : 2 * POINTS_PER_RESOLUTION + count]
        )
        window = self.window
        variance_factor = float(np.sum((window * (2.0 - window)) ** 2)) / (2.0 * spectra.samples)
        coherence = np.clip(coherence[:count], 1e-12, 1.0)
        return Response(
            self.frequency[:count],
            2.0 * raw_response[:count] - averaged_response,
            coherence,
            np.sqrt(variance_factor * (1.0 / coherence - 1.0)),
        )


class Response(NamedTuple):
    """A frequency response, its coherence and its uncertainty, shape (frequencies,) each."""

    frequency: Array  # Hz
    value: Complex  # response over reference
    coherence: Array  # magnitude squared
    relative_std: Array  # of the gain; in rad, of the phase

    @property
    def gain(self) -> Array:
        """Return the magnitude of the response."""
        return np.abs(self.value)

    @property
    def phase(self) -> Array:
        """Return the phase [rad], unwrapped from the lowest frequency on, at which it is from -pi to pi.

        The mean delay between neighbours on the grid is subtracted before unwrapping and added afterwards. If
        frequencies are missing, the phase changes by that delay over the gap; plain unwrapping would lose whole turns
        there.
        """
        wrapped_phase, steps = np.angle(self.value), np.diff(self.frequency)
        if not len(steps):
            return wrapped_phase
        neighbours = steps < 1.5 * steps.min()
        rotation = np.sum(np.exp(1j * np.diff(wrapped_phase))[neighbours])
        delay_phase = np.angle(rotation) / steps.min() * (self.frequency - self.frequency[0])
        return np.asarray(np.unwrap(wrapped_phase - delay_phase) + delay_phase, np.float64)

    def at(self, known: Mask) -> "Response":
        """Return the response at the frequencies of a mask, shape (frequencies,)."""
        return Response(self.frequency[known], self.value[known], self.coherence[known], self.relative_std[known])
