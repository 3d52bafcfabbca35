"""How late one channel is against another, stretch by stretch of a run."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.smoothing import slope, smooth

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Places = npt.NDArray[np.intp]
STRETCHES = 16  # of a run
FEWEST = 60  # samples of a stretch
FOLLOWS = 0.9  # of a stretch's variance, that the other channel explains once it is shifted
TELLS = 0.3  # samples, standard error up to which a stretch tells anything
WIDTH = 3.0  # samples of smoothing
ROUNDS = 4
REACH = 0.25  # of a stretch, that a shift is looked for in


@dataclass(frozen=True)
class Lateness:
    """Samples by which a channel is late, at the middle of each stretch that tells."""

    middle: Array  # samples from the run's first
    late: Array
    error: Array

    def __bool__(self) -> bool:
        return len(self.late) > 0

    def mean(self) -> tuple[float, float]:
        """Over all stretches, with its error."""
        weights = 1.0 / self.error**2
        mean = float(self.late @ weights / weights.sum())
        spread = float(np.std(self.late)) / np.sqrt(len(self.late))
        return mean, float(max(weights.sum() ** -0.5, spread))


def lateness(reads: Array, expected: Array, valid: Mask, count: int = STRETCHES) -> Lateness:
    """How late `reads` is against `expected` in each of so many stretches of a run."""
    length = len(reads) // count
    if length < FEWEST:
        count = max(len(reads) // FEWEST, 1)
        length = len(reads) // count
    width = max(WIDTH, width_of(expected))
    reads, expected = smooth(reads, width), smooth(expected, width)
    delays = []
    first = 0.0
    for index in range(count):
        begin = index * length
        told = shift_of(reads, expected, valid, begin, begin + length, first, width)
        if told is not None:
            first = told[0]
            delays.append((begin + 0.5 * length, *told))
    columns = np.array(delays).reshape(-1, 3)
    return Lateness(columns[:, 0], columns[:, 1], columns[:, 2])


def width_of(values: Array) -> float:
    """Smoothing after which a channel's slope is more than its noise, at most that of a stretch's tenth."""
    width, noise = WIDTH, noise_of(values)
    while width < len(values) / STRETCHES / 10.0 and noise / width**1.5 > 0.05 * float(
        np.std(np.diff(smooth(values, width)))
    ):
        width *= 2.0
    return width


def shift_of(
    reads: Array, expected: Array, valid: Mask, begin: int, end: int, first: float, width: float
) -> tuple[float, float] | None:
    """Samples by which a stretch is late, and the error; None where it tells nothing."""
    # neighbours within the smoothing tell the same
    at = np.arange(begin, end, max(int(width / 1.5), 1), dtype=np.intp)
    stamps = np.arange(len(expected), dtype=np.float64)
    if not valid[begin:end].all() or float(np.ptp(reads[at])) == 0.0 or float(np.ptp(expected[at])) == 0.0:
        return None
    margin = int(REACH * (end - begin))
    near = refined(reads, expected, at, stamps, first, width, margin)
    return near or refined(reads, expected, at, stamps, roughly(reads, expected, at, margin), width, margin)


def roughly(reads: Array, expected: Array, at: Places, margin: int) -> float:
    """The shift at which a stretch goes along best, to the spacing of the samples that are looked at."""
    every = int(at[1] - at[0])
    before, after = min(margin, int(at[0])) // every, min(margin, len(expected) - 1 - int(at[-1])) // every
    around = expected[at[0] - before * every : at[-1] + after * every + 1 : every]
    moved = sliding_window_view(around, len(at))
    moved = moved - moved.mean(axis=1, keepdims=True)
    power = np.sqrt(np.sum(moved**2, axis=1))
    along = np.abs(moved @ (reads[at] - reads[at].mean())) / np.where(power > 0.0, power, np.inf)
    return float((before - int(np.argmax(along))) * every)


def refined(
    reads: Array, expected: Array, at: Places, stamps: Array, late: float, width: float, margin: int
) -> tuple[float, float] | None:
    """A shift to a fraction of a sample, by the slope of what should be there, and its error."""
    values = reads[at] - reads[at].mean()
    low, high = max(int(at[0]) - 2 * margin, 0), int(at[-1]) + 2 * margin
    expected, stamps = expected[low:high], stamps[low:high]
    fitted = (0.0, 0.0, 1.0)
    for _ in range(ROUNDS):
        moved = np.interp(at - late, stamps, expected)
        columns = np.stack(
            [moved, -slope_at(np.asarray(at - late, np.float64), stamps, expected), np.ones(len(moved))], axis=1
        )
        solved, *_ = np.linalg.lstsq(columns, reads[at], rcond=1e-10)
        left = reads[at] - columns @ solved
        if solved[0] == 0.0 or not np.isfinite(solved).all():
            return None
        step = float(np.clip(solved[1] / solved[0], -width, width))
        late += step
        inverse = np.linalg.pinv(columns.T @ columns)
        if not inverse[1, 1] > 0.0:  # by rounding alone: the columns do not tell a shift
            return None
        independent = (at[-1] - at[0]) / (np.sqrt(4.0 * np.pi) * width)
        noise = float(left @ left) / max(independent - 3.0, 1.0)
        error = float(np.sqrt(inverse[1, 1] * noise) / abs(solved[0]))
        fitted = (late, error, float(left @ left) / float(values @ values))
    late, error, unexplained = fitted
    if abs(late) > margin or unexplained > 1.0 - FOLLOWS or error > TELLS * max(1.0, width / WIDTH):
        return None
    return late, max(error, 1e-3)


def slope_at(places: Array, stamps: Array, values: Array) -> Array:
    """The slope of a channel at places between its samples."""
    return np.asarray(np.interp(places, stamps, slope(values, 1.0)), np.float64)
