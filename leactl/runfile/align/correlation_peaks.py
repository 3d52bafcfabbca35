"""Find the time shifts at which one channel correlates most with another; a periodic signal has several."""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
FEWEST_COMMON = 20  # samples of each channel in the common time, for an estimate of the offset
FAR_APART = 4.0  # standard deviations by which a shift must fit worse than the best one to be excluded
MOST_PEAKS = 24  # peaks that are refined; a signal with more repetitions shows these in the first ones
MOST_STEPS = 2**21  # shifts of the coarse search
MOST_SAMPLES_COMPARED = 4000  # samples used while a peak is refined


class SimilarityPeak(NamedTuple):
    """A shift at which the correlation of two channels has a local maximum."""

    shift: float  # s
    likeness: float  # correlation
    explained: float  # sum of squares of the channel that the shifted reference explains, in the channel's unit squared


def peaks(
    time: Array, values: Array, base: Array, reference: Array, within: float, near: float = 0.0
) -> list[SimilarityPeak]:
    """Find the shifts of `time` at which values correlate with the reference, the highest correlation first.

    The search is coarse over the offsets from near - within to near + within, then repeatedly ten times finer around
    each peak, down to a hundredth of the shorter sampling interval.
    """
    finite, reference_finite = np.isfinite(values), np.isfinite(reference)
    time, values, base, reference = time[finite], values[finite], base[reference_finite], reference[reference_finite]
    if min(len(time), len(base)) < FEWEST_COMMON:
        return []
    intervals = float(np.median(np.diff(time))), float(np.median(np.diff(base)))
    coarse = max(*intervals, (time[-1] - time[0] + base[-1] - base[0]) / MOST_STEPS)

    def peak(shift: float, stride: int = 1) -> SimilarityPeak:
        shifted, samples = time[::stride] + shift, values[::stride]
        inside = (shifted >= base[0]) & (shifted <= base[-1])
        if inside.sum() < FEWEST_COMMON:
            return SimilarityPeak(shift, -1.0, 0.0)
        channel, reference_values = samples[inside], np.interp(shifted[inside], base, reference)
        spread = float(np.std(channel) * np.std(reference_values))
        correlation = (
            float(np.mean((channel - channel.mean()) * (reference_values - reference_values.mean()))) / spread
            if spread > 0
            else -1.0
        )
        return SimilarityPeak(
            shift, correlation, max(correlation, 0.0) ** 2 * float(np.var(channel) * inside.sum() * stride)
        )

    found_peaks = []
    for best in shifts_of_peaks(time, values, base, reference, within, near, coarse):
        step = min(coarse, within)
        while step > 0.01 * min(intervals):
            shifts = np.clip(np.linspace(best - step, best + step, 21), near - within, near + within)
            best = max(
                (peak(float(shift), max(1, len(time) // MOST_SAMPLES_COMPARED)) for shift in shifts), key=similarity_of
            ).shift
            step /= 10.0
        found_peaks.append(peak(best))
    return sorted(found_peaks, key=similarity_of, reverse=True)


def similarity_of(peak: SimilarityPeak) -> float:
    """Return the correlation at a peak, as sort key."""
    return peak.likeness


def ends_search(peak: SimilarityPeak, within: float, near: float) -> bool:
    """Return whether a peak lies at the end of the searched range, so that the true maximum may lie beyond it."""
    return abs(abs(peak.shift - near) - within) < 1e-9 * within


def shifts_of_peaks(
    time: Array, values: Array, base: Array, reference: Array, within: float, near: float, step: float
) -> list[float]:
    """Find the shifts, on a grid of `step`, at which the correlation has a peak that exceeds chance.

    The correlations at all shifts are computed together by Fourier transforms; each sample of the channel counts at
    its nearest step.
    """
    from scipy.signal import correlate, find_peaks

    cell = np.rint((time - time[0]) / step).astype(np.int64)
    centred = values - values.mean()
    reference_values = np.interp(np.arange(base[0], base[-1], step), base, reference - reference.mean())
    count, value_sums, square_sums = (
        np.bincount(cell, weights=column) for column in (np.ones(len(centred)), centred, centred * centred)
    )
    shifts = base[0] - time[0] + step * np.arange(1 - len(count), len(reference_values))
    searched = np.abs(shifts - near) <= within

    def summed(reference_signal: Array, channel_signal: npt.NDArray[Any]) -> Array:
        sums: Array = correlate(reference_signal, channel_signal, "full", "fft")[searched]
        return sums

    level = np.ones(len(reference_values))
    common = np.maximum(np.rint(summed(level, count)), 1.0)
    channel_mean, channel_square = summed(level, value_sums) / common, summed(level, square_sums) / common
    reference_mean, reference_square = (
        summed(reference_values, count) / common,
        summed(reference_values * reference_values, count) / common,
    )
    channel_variance, reference_variance = channel_square - channel_mean**2, reference_square - reference_mean**2
    # the rounding errors of the transforms are no variance of a constant channel
    usable = (
        (common >= FEWEST_COMMON)
        & (channel_variance > 1e-9 * np.var(centred))
        & (reference_variance > 1e-9 * np.var(reference_values))
    )
    likeness = np.full(len(common), -1.0)
    covariance = summed(reference_values, value_sums) / common - channel_mean * reference_mean
    likeness[usable] = covariance[usable] / np.sqrt(channel_variance[usable] * reference_variance[usable])
    if not usable.any():
        return [near]
    highest = int(np.argmax(likeness))
    effective_count = common[highest] / max(1.0, len(time) / np.count_nonzero(count))
    chance = FAR_APART * math.sqrt(max(2.0 * (1.0 - likeness[highest] ** 2), 1e-9) / effective_count)
    peak_indices = find_peaks(np.pad(likeness, 1, constant_values=-2.0), prominence=chance)[0] - 1
    return [
        float(shifts[searched][index])
        for index in sorted(peak_indices, key=lambda index: -likeness[index])[:MOST_PEAKS]
    ]
