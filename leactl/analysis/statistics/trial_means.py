"""Mean of one number for each trial: its uncertainty is that of the scatter between trials, and between runs.

Noise within a trial says nothing of what moves a whole trial, such as friction that differs from trial to trial.
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
    """The run of a trial by its number, and the side (direction or sign) that the trial was made on."""

    run: int
    side: int


def mean_of(
    values: Sequence[float], trials: Sequence[TrialLabel], name: str, units: str, relative_std: float = 0.0
) -> Estimate:
    """Average values of trials over the sides, each side the mean of its trials.

    `relative_std` is the relative standard uncertainty of a factor that all values share.

    Raises
    ------
    NotIdentifiable : no more trials than sides.
    """
    fit, weights = fit_sides(values, trials, name)
    return fit.estimate(name, units, weights, relative_std)


def fit_sides(
    values: Sequence[float], trials: Sequence[TrialLabel], error_prefix: str
) -> tuple[LeastSquaresFit, np.ndarray]:
    """Fit one constant for each side; return the fit and the weights of the coefficients in their mean.

    Where the runs differ by more than scatter, the uncertainty is that of the runs' means.
    """
    response = np.asarray(values, np.float64)
    sides = indicator_columns(np.array([trial.side for trial in trials]))
    run_sides = np.array([2 * trial.run + (trial.side > 0) for trial in trials])
    fit = least_squares(sides, response, sides, error_prefix)
    widened = widened_by(fit, partial_f_test(sides, response, indicator_columns(run_sides)))
    return widened, np.full(sides.shape[1], 1.0 / sides.shape[1])
