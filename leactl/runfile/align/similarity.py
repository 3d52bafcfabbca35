"""Shifts of one channel at which it is most like another, all of them: what repeats itself has several."""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
FEWEST_COMMON = 20  # samples of each channel that an estimated offset must rest on
FAR_APART = 4.0  # standard deviations by which a shift must fit worse than the best one to be none
MOST_PEAKS = 24  # that are looked at: what repeats itself more often shows it in them
MOST_STEPS = 2**21  # of the coarse search
ENOUGH = 4000  # samples to look for the likeliest offset with


class SimilarityPeak(NamedTuple):
    """A shift at which two channels are more alike than around it."""

    shift: float  # s
    likeness: float  # correlation
    explained: float  # sum of squares of the channel that the reference makes up


def peaks(
    time: Array, values: Array, base: Array, reference: Array, within: float, near: float = 0.0
) -> list[SimilarityPeak]:
    """Shifts of `time` at which values correlate with the reference, the likeliest first.

    Coarse over the whole range, then ten times finer around each until a hundredth of the shorter interval.
    """
    good, sound = np.isfinite(values), np.isfinite(reference)
    time, values, base, reference = time[good], values[good], base[sound], reference[sound]
    if min(len(time), len(base)) < FEWEST_COMMON:
        return []
    intervals = float(np.median(np.diff(time))), float(np.median(np.diff(base)))
    coarse = max(*intervals, (time[-1] - time[0] + base[-1] - base[0]) / MOST_STEPS)

    def peak(shift: float, every: int = 1) -> SimilarityPeak:
        moved, seen = time[::every] + shift, values[::every]
        inside = (moved >= base[0]) & (moved <= base[-1])
        if inside.sum() < FEWEST_COMMON:
            return SimilarityPeak(shift, -1.0, 0.0)
        own, there = seen[inside], np.interp(moved[inside], base, reference)
        spread = float(np.std(own) * np.std(there))
        alike = float(np.mean((own - own.mean()) * (there - there.mean()))) / spread if spread > 0 else -1.0
        return SimilarityPeak(shift, alike, max(alike, 0.0) ** 2 * float(np.var(own) * inside.sum() * every))

    found = []
    for best in likely_shifts(time, values, base, reference, within, near, coarse):
        step = min(coarse, within)
        while step > 0.01 * min(intervals):
            shifts = np.clip(np.linspace(best - step, best + step, 21), near - within, near + within)
            best = max((peak(float(shift), max(1, len(time) // ENOUGH)) for shift in shifts), key=likest).shift
            step /= 10.0
        found.append(peak(best))
    return sorted(found, key=likest, reverse=True)


def likest(peak: SimilarityPeak) -> float:
    """What peaks are sorted by."""
    return peak.likeness


def ends_search(peak: SimilarityPeak, within: float, near: float) -> bool:
    """Whether likeness rises up to the end of what is searched: its peak lies beyond."""
    return abs(abs(peak.shift - near) - within) < 1e-9 * within


def likely_shifts(
    time: Array, values: Array, base: Array, reference: Array, within: float, near: float, step: float
) -> list[float]:
    """Shifts in steps at which the likeness peaks, and falls by more than chance before it peaks again.

    All shifts at once by Fourier transforms; a sample of the channel counts at the step that it lies nearest to.
    """
    from scipy.signal import correlate, find_peaks

    cell = np.rint((time - time[0]) / step).astype(np.int64)
    seen = values - values.mean()
    there = np.interp(np.arange(base[0], base[-1], step), base, reference - reference.mean())
    count, first, second = (np.bincount(cell, weights=column) for column in (np.ones(len(seen)), seen, seen * seen))
    shifts = base[0] - time[0] + step * np.arange(1 - len(count), len(there))
    wanted = np.abs(shifts - near) <= within

    def summed(one: Array, other: npt.NDArray[Any]) -> Array:
        sums: Array = correlate(one, other, "full", "fft")[wanted]
        return sums

    level = np.ones(len(there))
    common = np.maximum(np.rint(summed(level, count)), 1.0)
    own_mean, own_square = summed(level, first) / common, summed(level, second) / common
    there_mean, there_square = summed(there, count) / common, summed(there * there, count) / common
    own_spread, there_spread = own_square - own_mean**2, there_square - there_mean**2
    # what the transforms round off is no change of a channel at rest
    sound = (common >= FEWEST_COMMON) & (own_spread > 1e-9 * np.var(seen)) & (there_spread > 1e-9 * np.var(there))
    likeness = np.full(len(common), -1.0)
    covariance = summed(there, first) / common - own_mean * there_mean
    likeness[sound] = covariance[sound] / np.sqrt(own_spread[sound] * there_spread[sound])
    if not sound.any():
        return [near]
    top = int(np.argmax(likeness))
    known = common[top] / max(1.0, len(time) / np.count_nonzero(count))
    chance = FAR_APART * math.sqrt(max(2.0 * (1.0 - likeness[top] ** 2), 1e-9) / known)
    at = find_peaks(np.pad(likeness, 1, constant_values=-2.0), prominence=chance)[0] - 1
    return [float(shifts[wanted][k]) for k in sorted(at, key=lambda k: -likeness[k])[:MOST_PEAKS]]
