"""Find the time shifts at which one channel correlates most with another; a periodic signal has several."""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
FEWEST_COMMON_SAMPLES = 20  # samples of each channel in the common time, for an estimate of the offset
REJECTION_STDS = 4.0  # standard deviations by which a shift must fit worse than the best shift to be excluded
MOST_PEAKS = 24  # peaks that are refined; if a signal repeats more often, the highest of them show it
MOST_STEPS = 2**21  # shifts of the coarse search
MOST_SAMPLES_COMPARED = 4000  # samples of the channel that are used while a peak is refined


class SimilarityPeak(NamedTuple):
    """A shift at which the correlation of two channels has a local maximum."""

    shift: float  # s
    correlation: float
    # part of the channel's sum of squares that the shifted reference explains, in the channel's unit squared
    explained_squares: float


def peaks(
    time: Array, values: Array, reference_time: Array, reference: Array, within: float, near: float = 0.0
) -> list[SimilarityPeak]:
    """Find the shifts [s] of `time` at which the values correlate with the reference, the highest correlation first.

    The search is coarse over the shifts from near - within to near + within [s], then repeatedly ten times finer around
    each peak, down to a hundredth of the shorter sampling interval.
    """
    finite, reference_finite = np.isfinite(values), np.isfinite(reference)
    time, values, reference_time, reference = (
        time[finite],
        values[finite],
        reference_time[reference_finite],
        reference[reference_finite],
    )
    if min(len(time), len(reference_time)) < FEWEST_COMMON_SAMPLES:
        return []
    intervals = float(np.median(np.diff(time))), float(np.median(np.diff(reference_time)))
    coarse_step = max(*intervals, (time[-1] - time[0] + reference_time[-1] - reference_time[0]) / MOST_STEPS)

    def peak(shift: float, stride: int = 1) -> SimilarityPeak:
        """Return the correlation at a shift [s], from every `stride`-th sample of the channel."""
        shifted, samples = time[::stride] + shift, values[::stride]
        is_inside = (shifted >= reference_time[0]) & (shifted <= reference_time[-1])
        if is_inside.sum() < FEWEST_COMMON_SAMPLES:
            return SimilarityPeak(shift, -1.0, 0.0)
        channel, reference_values = samples[is_inside], np.interp(shifted[is_inside], reference_time, reference)
        spread = float(np.std(channel) * np.std(reference_values))
        correlation = (
            float(np.mean((channel - channel.mean()) * (reference_values - reference_values.mean()))) / spread
            if spread > 0
            else -1.0
        )
        return SimilarityPeak(
            shift, correlation, max(correlation, 0.0) ** 2 * float(np.var(channel) * is_inside.sum() * stride)
        )

    refined_peaks = []
    for best_shift in shifts_of_peaks(time, values, reference_time, reference, within, near, coarse_step):
        step = min(coarse_step, within)
        while step > 0.01 * min(intervals):
            shifts = np.clip(np.linspace(best_shift - step, best_shift + step, 21), near - within, near + within)
            best_shift = max(
                (peak(float(shift), max(1, len(time) // MOST_SAMPLES_COMPARED)) for shift in shifts), key=similarity_of
            ).shift
            step /= 10.0
        refined_peaks.append(peak(best_shift))
    return sorted(refined_peaks, key=similarity_of, reverse=True)


def similarity_of(peak: SimilarityPeak) -> float:
    """Return the correlation at a peak, as sort key."""
    return peak.correlation


def is_at_end_of_search(peak: SimilarityPeak, within: float, near: float) -> bool:
    """Return whether a peak lies at the end of the searched range, so that the true maximum may lie beyond it."""
    return abs(abs(peak.shift - near) - within) < 1e-9 * within


def shifts_of_peaks(
    time: Array, values: Array, reference_time: Array, reference: Array, within: float, near: float, step: float
) -> list[float]:
    """Find the shifts [s], on a grid of `step` [s], at which the correlation has a peak that exceeds chance.

    The correlations at all shifts are computed together by Fourier transforms; each sample of the channel counts at
    its nearest step.
    """
    from scipy.signal import correlate, find_peaks

    step_of_sample = np.rint((time - time[0]) / step).astype(np.int64)
    centred = values - values.mean()
    reference_values = np.interp(
        np.arange(reference_time[0], reference_time[-1], step), reference_time, reference - reference.mean()
    )
    count, value_sums, square_sums = (
        np.bincount(step_of_sample, weights=column) for column in (np.ones(len(centred)), centred, centred * centred)
    )
    shifts = reference_time[0] - time[0] + step * np.arange(1 - len(count), len(reference_values))
    is_searched = np.abs(shifts - near) <= within

    def summed(reference_signal: Array, channel_signal: npt.NDArray[Any]) -> Array:
        """Return the sum of the products of a reference signal and a channel signal at each searched shift."""
        sums: Array = correlate(reference_signal, channel_signal, "full", "fft")[is_searched]
        return sums

    constant = np.ones(len(reference_values))
    common_counts = np.maximum(np.rint(summed(constant, count)), 1.0)
    channel_mean, channel_square = (
        summed(constant, value_sums) / common_counts,
        summed(constant, square_sums) / common_counts,
    )
    reference_mean, reference_square = (
        summed(reference_values, count) / common_counts,
        summed(reference_values * reference_values, count) / common_counts,
    )
    channel_variance, reference_variance = channel_square - channel_mean**2, reference_square - reference_mean**2
    # the rounding errors of the transforms are no variance of a constant channel
    is_usable = (
        (common_counts >= FEWEST_COMMON_SAMPLES)
        & (channel_variance > 1e-9 * np.var(centred))
        & (reference_variance > 1e-9 * np.var(reference_values))
    )
    correlation = np.full(len(common_counts), -1.0)
    covariance = summed(reference_values, value_sums) / common_counts - channel_mean * reference_mean
    correlation[is_usable] = covariance[is_usable] / np.sqrt(
        channel_variance[is_usable] * reference_variance[is_usable]
    )
    if not is_usable.any():
        return [near]
    highest_index = int(np.argmax(correlation))
    effective_count = common_counts[highest_index] / max(1.0, len(time) / np.count_nonzero(count))
    least_prominence = REJECTION_STDS * math.sqrt(
        max(2.0 * (1.0 - correlation[highest_index] ** 2), 1e-9) / effective_count
    )
    peak_indices = find_peaks(np.pad(correlation, 1, constant_values=-2.0), prominence=least_prominence)[0] - 1
    return [
        float(shifts[is_searched][index])
        for index in sorted(peak_indices, key=lambda index: -correlation[index])[:MOST_PEAKS]
    ]
