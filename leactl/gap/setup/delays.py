"""Measure how late one channel is against another, in stretches of a run."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.smoothing import slope, smooth

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]
STRETCHES = 16  # into which a run is divided where the caller states no other count
FEWEST_STRETCH_SAMPLES = 60  # a run with shorter stretches is divided into fewer, or into one
LEAST_FOLLOWED_SHARE = 0.9  # smallest share of a stretch's variance that the shifted other channel explains
# samples, largest standard error of a stretch that counts; larger in proportion to a smoothing above LEAST_SMOOTHING
MOST_SHIFT_ERROR = 0.3
LEAST_ERROR = 1e-3  # samples, of a shift: weights of noiseless records stay finite
LEAST_SMOOTHING = 3.0  # samples, standard deviation of the Gaussian
REFINEMENT_ROUNDS = 4  # Gauss-Newton steps
MOST_SHIFT_SHARE = 0.25  # largest shift that is searched, as a share of a stretch


@dataclass(frozen=True)
class Lateness:
    """Lateness of a channel at the middle of each stretch that determines it; arrays have shape (stretches,)."""

    middle: Array  # samples from the run's first
    late: Array  # samples; negative: early
    error: Array  # samples, standard error

    def __bool__(self) -> bool:
        return len(self.late) > 0

    def mean(self) -> tuple[float, float]:
        """Return the weighted mean [samples] over all stretches, and its standard error.

        The error is by the weights or by the scatter, whichever is larger.
        """
        weights = 1.0 / self.error**2
        mean = float(self.late @ weights / weights.sum())
        spread = float(np.std(self.late)) / np.sqrt(len(self.late))
        return mean, float(max(weights.sum() ** -0.5, spread))


def lateness(measured: Array, expected: Array, valid: Mask, count: int = STRETCHES) -> Lateness:
    """Return by how many samples a channel is late, in each of `count` stretches of a run that determine it.

    Parameters
    ----------
    measured, expected : values of the channel, and those that it would have if it were not late; shape (samples,).
    valid : whether each sample is valid, shape (samples,); a stretch with an invalid sample does not count.
    """
    length = len(measured) // count
    if length < FEWEST_STRETCH_SAMPLES:
        count = max(len(measured) // FEWEST_STRETCH_SAMPLES, 1)
        length = len(measured) // count
    width = max(LEAST_SMOOTHING, width_of(expected))
    measured, expected = smooth(measured, width), smooth(expected, width)
    rows = []
    shift = 0.0
    for index in range(count):
        begin = index * length
        shift_and_error = shift_of(measured, expected, valid, begin, begin + length, shift, width)
        if shift_and_error is not None:
            shift = shift_and_error[0]
            rows.append((begin + 0.5 * length, *shift_and_error))
    columns = np.array(rows).reshape(-1, 3)
    return Lateness(columns[:, 0], columns[:, 1], columns[:, 2])


def width_of(values: Array) -> float:
    """Return the width of the smoothing [samples] that makes the noise of a channel's slope small.

    It is doubled until the noise is at most 5 % of the scatter of the slope, or until the width is a tenth of one of
    `STRETCHES` stretches.
    """
    width, noise = LEAST_SMOOTHING, noise_of(values)
    # smoothing over a width divides the noise of a slope by width ** 1.5
    while width < len(values) / STRETCHES / 10.0 and noise / width**1.5 > 0.05 * float(
        np.std(np.diff(smooth(values, width)))
    ):
        width *= 2.0
    return width


def shift_of(
    measured: Array, expected: Array, valid: Mask, begin: int, end: int, start_shift: float, width: float
) -> tuple[float, float] | None:
    """Return by how many samples a stretch is late, and the standard error [samples]; None if it is not determined."""
    # neighbours within the smoothing carry no further information
    samples = np.arange(begin, end, max(int(width / 1.5), 1), dtype=np.intp)
    stamps = np.arange(len(expected), dtype=np.float64)
    if not valid[begin:end].all() or float(np.ptp(measured[samples])) == 0.0 or float(np.ptp(expected[samples])) == 0.0:
        return None
    largest_shift = int(MOST_SHIFT_SHARE * (end - begin))
    near_shift = refined_shift(measured, expected, samples, stamps, start_shift, width, largest_shift)
    if near_shift is not None:
        return near_shift
    far_shift = rough_shift(measured, expected, samples, largest_shift)
    return refined_shift(measured, expected, samples, stamps, far_shift, width, largest_shift)


def rough_shift(measured: Array, expected: Array, samples: Indices, largest_shift: int) -> float:
    """Return the shift [samples] with the largest correlation, a multiple of the spacing of `samples`."""
    spacing = int(samples[1] - samples[0])
    steps_before, steps_after = (
        min(largest_shift, int(samples[0])) // spacing,
        min(largest_shift, len(expected) - 1 - int(samples[-1])) // spacing,
    )
    search_range = expected[samples[0] - steps_before * spacing : samples[-1] + steps_after * spacing + 1 : spacing]
    windows = sliding_window_view(search_range, len(samples))
    windows = windows - windows.mean(axis=1, keepdims=True)
    norm = np.sqrt(np.sum(windows**2, axis=1))
    correlation = np.abs(windows @ (measured[samples] - measured[samples].mean())) / np.where(norm > 0.0, norm, np.inf)
    return float((steps_before - int(np.argmax(correlation))) * spacing)


def refined_shift(
    measured: Array, expected: Array, samples: Indices, stamps: Array, shift: float, width: float, largest_shift: int
) -> tuple[float, float] | None:
    """Refine a shift to a fraction of a sample by Gauss-Newton steps; return it and its standard error [samples].

    Return None if the shift is beyond `largest_shift`, explains too little, or has too large an error.
    """
    values = measured[samples] - measured[samples].mean()
    low, high = max(int(samples[0]) - 2 * largest_shift, 0), int(samples[-1]) + 2 * largest_shift
    expected, stamps = expected[low:high], stamps[low:high]
    fitted = (0.0, 0.0, 1.0)
    for _ in range(REFINEMENT_ROUNDS):
        shifted_values = np.interp(samples - shift, stamps, expected)
        shifted_slope = slope_at(np.asarray(samples - shift, np.float64), stamps, expected)
        columns = np.stack([shifted_values, -shifted_slope, np.ones(len(shifted_values))], axis=1)
        coefficients, *_ = np.linalg.lstsq(columns, measured[samples], rcond=1e-10)
        residual = measured[samples] - columns @ coefficients
        if coefficients[0] == 0.0 or not np.isfinite(coefficients).all():
            return None
        step = float(np.clip(coefficients[1] / coefficients[0], -width, width))
        shift += step
        inverse = np.linalg.pinv(columns.T @ columns)
        if not inverse[1, 1] > 0.0:  # only by rounding: the columns do not determine a shift
            return None
        # a Gaussian of this width leaves one independent sample in sqrt(4 pi) widths
        independent_samples = (samples[-1] - samples[0]) / (np.sqrt(4.0 * np.pi) * width)
        noise = float(residual @ residual) / max(independent_samples - 3.0, 1.0)
        error = float(np.sqrt(inverse[1, 1] * noise) / abs(coefficients[0]))
        fitted = (shift, error, float(residual @ residual) / float(values @ values))
    shift, error, unexplained = fitted
    if (
        abs(shift) > largest_shift
        or unexplained > 1.0 - LEAST_FOLLOWED_SHARE
        or error > MOST_SHIFT_ERROR * max(1.0, width / LEAST_SMOOTHING)
    ):
        return None
    return shift, max(error, LEAST_ERROR)


def slope_at(positions: Array, stamps: Array, values: Array) -> Array:
    """Return the slope of a channel at positions between its samples."""
    return np.asarray(np.interp(positions, stamps, slope(values, 1.0)), np.float64)
