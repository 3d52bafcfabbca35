"""Find the frequency of a residual in time: fitted on the fitted runs and tested on the held-out ones.

An external torque that does not depend on the shaft, as from a pump on the bench, follows no logged state and averages
out within a stretch of a run, but makes a line in the spectrum of the residual. Its phase differs between runs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
FEWEST_PERIODS = 8.0  # periods of a sine within a run; with fewer it is a slow change
QUARTERS = 4  # quarters of a run; a sine is fitted to every second one
OVERSAMPLING = 8  # frequencies tried within the resolution of a run's length


@dataclass(frozen=True, eq=False)
class ResidualCourse:
    """Residual of one equation on one run over time."""

    time: Array  # s
    residual: Array
    stretch: npt.NDArray[np.intp]  # stretch of each row; the run is cut into equal stretches

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def step(self) -> float:
        """Median time between rows [s]."""
        return float(np.median(np.diff(self.time)))


def strongest_frequency(courses: Sequence[ResidualCourse]) -> float | None:
    """Return the frequency [Hz] whose sine explains most squares of all runs; None where no run is long enough.

    Rows are put on one grid of times with zeros in the gaps, so that one transform per run gives all frequencies.
    """
    step, longest = max(course.step for course in courses), max(course.duration for course in courses)
    points = int(OVERSAMPLING * longest / step) + 1
    frequencies = np.fft.rfftfreq(points, step)
    power = np.zeros(len(frequencies))
    for course in courses:
        grid_index = np.rint((course.time - course.time[0]) / step).astype(np.intp)
        grid = np.bincount(grid_index, weights=course.residual - course.residual.mean(), minlength=points)
        resolved = frequencies * course.duration >= FEWEST_PERIODS
        power += np.where(resolved, np.abs(np.fft.rfft(grid, points)) ** 2 / len(course.residual), 0.0)
    return float(frequencies[np.argmax(power)]) if power.any() else None


def gains(course: ResidualCourse, frequency: float) -> Array:
    """Return, for each row, the squares of the residual that a sine fitted to the other half of the run explains.

    A half is every second quarter: a sine continues through the quarter between, and a slow change does not. The
    frequency is fitted to that half as well, within the resolution of the run's length.
    """
    explained = np.zeros(len(course.residual))
    if frequency * course.duration < FEWEST_PERIODS:
        return explained
    frequencies = frequency + np.linspace(-1.0, 1.0, 2 * OVERSAMPLING + 1) / course.duration
    stretch_number = course.stretch - course.stretch[0]
    quarter = QUARTERS * stretch_number // (stretch_number[-1] + 1)
    for parity in (0, 1):
        is_judged = quarter % 2 == parity
        if not is_judged.any() or is_judged.all():
            return explained
        best_sine = min(
            (_fitted_sine(course, ~is_judged, candidate) for candidate in frequencies), key=lambda fit: fit[0]
        )[1]
        explained[is_judged] = (
            course.residual[is_judged] ** 2 - (course.residual[is_judged] - best_sine[is_judged]) ** 2
        )
    return explained


def _fitted_sine(course: ResidualCourse, is_learnt: npt.NDArray[np.bool_], frequency: float) -> tuple[float, Array]:
    """Return the squared residual of the learnt rows under the sine [Hz] fitted to them, and the sine at all rows."""
    phase = 2.0 * np.pi * frequency * (course.time - course.time[0])
    columns = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    sine = columns @ np.linalg.lstsq(columns[is_learnt], course.residual[is_learnt], rcond=None)[0]
    return float(np.sum((course.residual[is_learnt] - sine[is_learnt]) ** 2)), sine
