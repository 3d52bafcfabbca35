"""The mean of what single trials gave, one number each: its uncertainty is that of their scatter, run against run too.

Noise within a trial says nothing of what moves a trial as a whole, such as friction that is another each time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import Estimate
from leactl.analysis.statistics.regression import (
    LeastSquaresFit,
    indicator_columns,
    least_squares,
    partial_f_test,
    widened_by,
)


@dataclass(frozen=True)
class TrialLabel:
    """Whose a number is: the run's place among the runs, and the side (direction, sign) that it was taken from."""

    run: int
    side: int


def mean_of(
    values: Sequence[float], trials: Sequence[TrialLabel], name: str, units: str, relative_std: float = 0.0
) -> Estimate:
    """The mean over the sides, each the mean of its trials; `relative_std` is of a factor that they share.

    Raises
    ------
    NotIdentifiable : no more trials than sides.
    """
    fit, weights = fit_sides(values, trials, name)
    return fit.estimate(name, units, weights, relative_std)


def fit_sides(values: Sequence[float], trials: Sequence[TrialLabel], place: str) -> tuple[LeastSquaresFit, np.ndarray]:
    """One constant a side, judged by the runs where they differ by more than scatter; and the weights of their mean."""
    response = np.asarray(values, np.float64)
    sides = indicator_columns(np.array([trial.side for trial in trials]))
    cells = np.array([2 * trial.run + (trial.side > 0) for trial in trials])
    fit = least_squares(sides, response, sides, place)
    judged = widened_by(fit, partial_f_test(sides, response, indicator_columns(cells)))
    return judged, np.full(sides.shape[1], 1.0 / sides.shape[1])
