"""Mean of one number for each trial: its uncertainty is that of the scatter between trials, and between runs.

Noise within a trial does not show what changes a whole trial, such as friction that differs from trial to trial.
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
    """The number of a trial's run, and the side (direction or sign, 1 or -1) of the trial."""

    run: int
    side: int


def mean_of(
    values: Sequence[float], trials: Sequence[TrialLabel], name: str, units: str, relative_std: float = 0.0
) -> Estimate:
    """Estimate the mean over the sides of the values of trials, where each side is the mean of its trials.

    `relative_std` is the relative standard uncertainty of a factor that all values share.

    Raises
    ------
    NotIdentifiable : there are no more trials than sides.
    """
    fit, weights = fit_sides(values, trials, name)
    return fit.estimate(name, units, weights, relative_std)


def fit_sides(
    values: Sequence[float], trials: Sequence[TrialLabel], error_prefix: str
) -> tuple[LeastSquaresFit, np.ndarray]:
    """Return the fit of one constant for each side, and the weights of the constants in their mean.

    If the runs differ by more than scatter, the uncertainty is that of the runs' means.
    """
    response = np.asarray(values, np.float64)
    side_columns = indicator_columns(np.array([trial.side for trial in trials]))
    run_and_side = np.array([2 * trial.run + (trial.side > 0) for trial in trials])
    fit = least_squares(side_columns, response, side_columns, error_prefix)
    widened_fit = widened_by(fit, partial_f_test(side_columns, response, indicator_columns(run_and_side)))
    return widened_fit, np.full(side_columns.shape[1], 1.0 / side_columns.shape[1])
