"""Measure how late one channel is against another, in stretches of a run."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.smoothing import slope, smooth

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Places = npt.NDArray[np.intp]
STRETCHES = 16  # stretches of a run
FEWEST_STRETCH_SAMPLES = 60
LEAST_FOLLOWED_SHARE = 0.9  # smallest share of a stretch's variance that the shifted other channel explains
MOST_SHIFT_ERROR = 0.3  # samples, largest standard error of a stretch that counts
LEAST_WIDTH = 3.0  # samples of smoothing
REFINEMENT_ROUNDS = 4  # Gauss-Newton steps
MOST_SHIFT_SHARE = 0.25  # largest shift that is searched, as a share of a stretch


@dataclass(frozen=True)
class Lateness:
    """Lateness of a channel in samples, at the middle of each stretch that determines it."""

    middle: Array  # samples from the run's first
    late: Array
    error: Array

    def __bool__(self) -> bool:
        return len(self.late) > 0

    def mean(self) -> tuple[float, float]:
        """Return the weighted mean over all stretches, and its error."""
        weights = 1.0 / self.error**2
        mean = float(self.late @ weights / weights.sum())
        spread = float(np.std(self.late)) / np.sqrt(len(self.late))
        return mean, float(max(weights.sum() ** -0.5, spread))


def lateness(reads: Array, expected: Array, valid: Mask, count: int = STRETCHES) -> Lateness:
    """Return how late `reads` is against `expected`, in each of `count` stretches of a run."""
    length = len(reads) // count
    if length < FEWEST_STRETCH_SAMPLES:
        count = max(len(reads) // FEWEST_STRETCH_SAMPLES, 1)
        length = len(reads) // count
    width = max(LEAST_WIDTH, width_of(expected))
    reads, expected = smooth(reads, width), smooth(expected, width)
    delays = []
    shift = 0.0
    for index in range(count):
        begin = index * length
        shift_and_error = shift_of(reads, expected, valid, begin, begin + length, shift, width)
        if shift_and_error is not None:
            shift = shift_and_error[0]
            delays.append((begin + 0.5 * length, *shift_and_error))
    columns = np.array(delays).reshape(-1, 3)
    return Lateness(columns[:, 0], columns[:, 1], columns[:, 2])


def width_of(values: Array) -> float:
    """Return the smoothing [samples] that makes the noise of a channel's slope small, up to a tenth of a stretch."""
    width, noise = LEAST_WIDTH, noise_of(values)
    while width < len(values) / STRETCHES / 10.0 and noise / width**1.5 > 0.05 * float(
        np.std(np.diff(smooth(values, width)))
    ):
        width *= 2.0
    return width


def shift_of(
    reads: Array, expected: Array, valid: Mask, begin: int, end: int, start_shift: float, width: float
) -> tuple[float, float] | None:
    """Return the samples by which a stretch is late, and the error; None where it is not determined."""
    # neighbours within the smoothing carry no further information
    samples = np.arange(begin, end, max(int(width / 1.5), 1), dtype=np.intp)
    stamps = np.arange(len(expected), dtype=np.float64)
    if not valid[begin:end].all() or float(np.ptp(reads[samples])) == 0.0 or float(np.ptp(expected[samples])) == 0.0:
        return None
    margin = int(MOST_SHIFT_SHARE * (end - begin))
    near_shift = refined_shift(reads, expected, samples, stamps, start_shift, width, margin)
    return near_shift or refined_shift(
        reads, expected, samples, stamps, rough_shift(reads, expected, samples, margin), width, margin
    )


def rough_shift(reads: Array, expected: Array, samples: Places, margin: int) -> float:
    """Return the shift with the largest correlation, to the spacing of the samples."""
    spacing = int(samples[1] - samples[0])
    steps_before, steps_after = (
        min(margin, int(samples[0])) // spacing,
        min(margin, len(expected) - 1 - int(samples[-1])) // spacing,
    )
    around = expected[samples[0] - steps_before * spacing : samples[-1] + steps_after * spacing + 1 : spacing]
    windows = sliding_window_view(around, len(samples))
    windows = windows - windows.mean(axis=1, keepdims=True)
    power = np.sqrt(np.sum(windows**2, axis=1))
    correlation = np.abs(windows @ (reads[samples] - reads[samples].mean())) / np.where(power > 0.0, power, np.inf)
    return float((steps_before - int(np.argmax(correlation))) * spacing)


def refined_shift(
    reads: Array, expected: Array, samples: Places, stamps: Array, late: float, width: float, margin: int
) -> tuple[float, float] | None:
    """Refine a shift to a fraction of a sample by Gauss-Newton steps; return it and its error, None if unclear."""
    values = reads[samples] - reads[samples].mean()
    low, high = max(int(samples[0]) - 2 * margin, 0), int(samples[-1]) + 2 * margin
    expected, stamps = expected[low:high], stamps[low:high]
    fitted = (0.0, 0.0, 1.0)
    for _ in range(REFINEMENT_ROUNDS):
        moved = np.interp(samples - late, stamps, expected)
        columns = np.stack(
            [moved, -slope_at(np.asarray(samples - late, np.float64), stamps, expected), np.ones(len(moved))], axis=1
        )
        solved, *_ = np.linalg.lstsq(columns, reads[samples], rcond=1e-10)
        residual = reads[samples] - columns @ solved
        if solved[0] == 0.0 or not np.isfinite(solved).all():
            return None
        step = float(np.clip(solved[1] / solved[0], -width, width))
        late += step
        inverse = np.linalg.pinv(columns.T @ columns)
        if not inverse[1, 1] > 0.0:  # only by rounding: the columns do not determine a shift
            return None
        independent = (samples[-1] - samples[0]) / (np.sqrt(4.0 * np.pi) * width)
        noise = float(residual @ residual) / max(independent - 3.0, 1.0)
        error = float(np.sqrt(inverse[1, 1] * noise) / abs(solved[0]))
        fitted = (late, error, float(residual @ residual) / float(values @ values))
    late, error, unexplained = fitted
    if (
        abs(late) > margin
        or unexplained > 1.0 - LEAST_FOLLOWED_SHARE
        or error > MOST_SHIFT_ERROR * max(1.0, width / LEAST_WIDTH)
    ):
        return None
    return late, max(error, 1e-3)


def slope_at(positions: Array, stamps: Array, values: Array) -> Array:
    """Return the slope of a channel at positions between its samples."""
    return np.asarray(np.interp(positions, stamps, slope(values, 1.0)), np.float64)
