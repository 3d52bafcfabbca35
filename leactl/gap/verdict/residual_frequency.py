"""What a residual repeats by in time: one frequency, found on the fitted runs and tried on the held-out ones.

A torque from outside that knows nothing of the shaft, as of a pump on the bench, follows no logged state and averages
out within a stretch of a run, and yet it is a line in the spectrum of what is left over. Its phase is another in each
run.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
FEWEST_PERIODS = 8.0  # within a run, below which it tells of no frequency: that is a slow change
QUARTERS = 4
OVERSAMPLED = 8  # frequencies that are tried within what a run's length tells apart


@dataclass(frozen=True, eq=False)
class ResidualCourse:
    """What one equation leaves over of one run, over time."""

    time: Array  # s
    left: Array
    stretch: npt.NDArray[np.intp]  # of the run, cut into equal ones

    @property
    def duration(self) -> float:
        """From its first row to its last [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def step(self) -> float:
        """From one row to the next, as a rule [s]."""
        return float(np.median(np.diff(self.time)))


def strongest_frequency(courses: Sequence[ResidualCourse]) -> float | None:
    """The frequency whose sine explains most squares of all runs together [Hz]; None where no run is long enough.

    Rows are put on one grid of times and the gaps between them left zero, so that one transform a run does for all
    frequencies.
    """
    step, longest = max(course.step for course in courses), max(course.duration for course in courses)
    points = int(OVERSAMPLED * longest / step) + 1
    frequencies = np.fft.rfftfreq(points, step)
    power = np.zeros(len(frequencies))
    for course in courses:
        place = np.rint((course.time - course.time[0]) / step).astype(np.intp)
        grid = np.bincount(place, weights=course.left - course.left.mean(), minlength=points)
        told = frequencies * course.duration >= FEWEST_PERIODS
        power += np.where(told, np.abs(np.fft.rfft(grid, points)) ** 2 / len(course.left), 0.0)
    return float(frequencies[np.argmax(power)]) if power.any() else None


def gains(course: ResidualCourse, frequency: float) -> Array:
    """Squares of each row that a sine explains whose phase the other half of the run tells.

    A half is every second quarter: a sine goes on through the quarter between, and what merely changes slowly does not.
    The frequency is settled by that half as well, within what the run's length tells apart.
    """
    gained = np.zeros(len(course.left))
    if frequency * course.duration < FEWEST_PERIODS:
        return gained
    near = frequency + np.linspace(-1.0, 1.0, 2 * OVERSAMPLED + 1) / course.duration
    first = course.stretch - course.stretch[0]
    quarter = QUARTERS * first // (first[-1] + 1)
    for half in (0, 1):
        judged = quarter % 2 == half
        if not judged.any() or judged.all():
            return gained
        best = min((_sine(course, ~judged, one) for one in near), key=lambda found: found[0])[1]
        gained[judged] = course.left[judged] ** 2 - (course.left[judged] - best[judged]) ** 2
    return gained


def _sine(course: ResidualCourse, learnt: npt.NDArray[np.bool_], frequency: float) -> tuple[float, Array]:
    """The squares that are left of the rows that a sine is learnt on, and what it says of all rows."""
    turned = 2.0 * np.pi * frequency * (course.time - course.time[0])
    columns = np.stack([np.cos(turned), np.sin(turned)], axis=1)
    said = columns @ np.linalg.lstsq(columns[learnt], course.left[learnt], rcond=None)[0]
    return float(np.sum((course.left[learnt] - said[learnt]) ** 2)), said
