"""Time shifts at which one channel correlates most with another; a signal that repeats itself has several."""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
FEWEST_COMMON = 20  # samples of each channel that an estimated offset must rest on
FAR_APART = 4.0  # standard deviations by which a shift must fit worse than the best one to be none
MOST_PEAKS = 24  # that are looked at: what repeats itself more often shows it in them
MOST_STEPS = 2**21  # of the coarse search
MOST_SAMPLES_COMPARED = 4000  # samples to look for the likeliest offset with


class SimilarityPeak(NamedTuple):
    """A shift at which the correlation of two channels has a local maximum."""

    shift: float  # s
    likeness: float  # correlation
    explained: float  # sum of squares of the channel that the shifted reference explains


def peaks(
    time: Array, values: Array, base: Array, reference: Array, within: float, near: float = 0.0
) -> list[SimilarityPeak]:
    """Shifts of `time` at which values correlate with the reference, the highest correlation first.

    The search is coarse over the whole range, then ten times finer around each peak, down to a hundredth of the
    shorter sampling interval.
    """
    finite, reference_finite = np.isfinite(values), np.isfinite(reference)
    time, values, base, reference = time[finite], values[finite], base[reference_finite], reference[reference_finite]
    if min(len(time), len(base)) < FEWEST_COMMON:
        return []
    intervals = float(np.median(np.diff(time))), float(np.median(np.diff(base)))
    coarse = max(*intervals, (time[-1] - time[0] + base[-1] - base[0]) / MOST_STEPS)

    def peak(shift: float, every: int = 1) -> SimilarityPeak:
        shifted, samples = time[::every] + shift, values[::every]
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
            shift, correlation, max(correlation, 0.0) ** 2 * float(np.var(channel) * inside.sum() * every)
        )

    candidates = []
    for best in shifts_of_peaks(time, values, base, reference, within, near, coarse):
        step = min(coarse, within)
        while step > 0.01 * min(intervals):
            shifts = np.clip(np.linspace(best - step, best + step, 21), near - within, near + within)
            best = max(
                (peak(float(shift), max(1, len(time) // MOST_SAMPLES_COMPARED)) for shift in shifts), key=similarity_of
            ).shift
            step /= 10.0
        candidates.append(peak(best))
    return sorted(candidates, key=similarity_of, reverse=True)


def similarity_of(peak: SimilarityPeak) -> float:
    """The correlation at a peak, as sort key."""
    return peak.likeness


def ends_search(peak: SimilarityPeak, within: float, near: float) -> bool:
    """Whether a peak lies at the end of the searched range, so that the true maximum may lie beyond it."""
    return abs(abs(peak.shift - near) - within) < 1e-9 * within


def shifts_of_peaks(
    time: Array, values: Array, base: Array, reference: Array, within: float, near: float, step: float
) -> list[float]:
    """Shifts, on a grid of `step`, at which the correlation peaks by more than chance.

    All shifts are computed at once by Fourier transforms; each sample of the channel counts at its nearest step.
    """
    from scipy.signal import correlate, find_peaks

    cell = np.rint((time - time[0]) / step).astype(np.int64)
    centred = values - values.mean()
    reference_values = np.interp(np.arange(base[0], base[-1], step), base, reference - reference.mean())
    count, first, second = (
        np.bincount(cell, weights=column) for column in (np.ones(len(centred)), centred, centred * centred)
    )
    shifts = base[0] - time[0] + step * np.arange(1 - len(count), len(reference_values))
    searched = np.abs(shifts - near) <= within

    def summed(first_signal: Array, second_signal: npt.NDArray[Any]) -> Array:
        sums: Array = correlate(first_signal, second_signal, "full", "fft")[searched]
        return sums

    level = np.ones(len(reference_values))
    common = np.maximum(np.rint(summed(level, count)), 1.0)
    channel_mean, channel_square = summed(level, first) / common, summed(level, second) / common
    reference_mean, reference_square = (
        summed(reference_values, count) / common,
        summed(reference_values * reference_values, count) / common,
    )
    channel_variance, reference_variance = channel_square - channel_mean**2, reference_square - reference_mean**2
    # what the transforms round off is no change of a channel at rest
    usable = (
        (common >= FEWEST_COMMON)
        & (channel_variance > 1e-9 * np.var(centred))
        & (reference_variance > 1e-9 * np.var(reference_values))
    )
    likeness = np.full(len(common), -1.0)
    covariance = summed(reference_values, first) / common - channel_mean * reference_mean
    likeness[usable] = covariance[usable] / np.sqrt(channel_variance[usable] * reference_variance[usable])
    if not usable.any():
        return [near]
    top = int(np.argmax(likeness))
    effective_count = common[top] / max(1.0, len(time) / np.count_nonzero(count))
    chance = FAR_APART * math.sqrt(max(2.0 * (1.0 - likeness[top] ** 2), 1e-9) / effective_count)
    at = find_peaks(np.pad(likeness, 1, constant_values=-2.0), prominence=chance)[0] - 1
    return [float(shifts[searched][k]) for k in sorted(at, key=lambda k: -likeness[k])[:MOST_PEAKS]]
