"""Least squares with instruments and Student t intervals, and tests whether anything but scatter is in the residuals.

Draper & Smith, Applied Regression Analysis, 3rd ed.: estimates and intervals in chapter 5, lack of fit in section 2.1.
Wooldridge, Introductory Econometrics, 5th ed., chapter 15: instruments for regressors that carry errors.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import Estimate
from leactl.errors import NotIdentifiable

Array = npt.NDArray[np.float64]

CONFIDENCE = 0.95  # of all intervals
RANK_TOLERANCE = 1e-9  # of the largest singular value, with columns scaled to length one
DEPARTURE_P_VALUE = 0.01  # with a lower probability, groups depart from the fit by more than scatter
POOLING_P_VALUE = 0.25  # with a higher probability, group differences count as scatter (Bancroft & Han, 1983)
EXACT_FIT_SHARE = 1e-24  # of the response's sum of squares, which rounding leaves in an exact fit


def t_quantile(dof: float) -> float:
    """Return the half width of the 95 % interval in standard errors, by Student's t with `dof` degrees of freedom."""
    from scipy.special import stdtrit  # scipy.stats takes half a second to import

    return float(stdtrit(min(dof, 1e9), 0.5 + CONFIDENCE / 2))


@dataclass(frozen=True, eq=False)
class LeastSquaresFit:
    """A least-squares fit: response = design @ coefficients + residuals."""

    coefficients: Array  # shape (unknowns,)
    unscaled_covariance: Array  # covariance of the coefficients at unit variance, shape (unknowns, unknowns)
    projected: Array  # part of the design that its instruments explain; the residuals are orthogonal to it
    residuals: Array  # shape (points,)
    variance: float  # of one point, in the response's unit squared
    dof: float  # degrees of freedom of the variance
    r_squared: float

    @property
    def explained(self) -> Array:
        """Return the response that the projected design fits with these coefficients and residuals, shape (points,)."""
        return self.projected @ self.coefficients + self.residuals

    def combination(self, weights: Array) -> tuple[float, float]:
        """Return value and standard error of a linear combination of the coefficients."""
        variance = self.variance * float(weights @ self.unscaled_covariance @ weights)
        return float(weights @ self.coefficients), math.sqrt(max(variance, 0.0))

    def estimate(self, name: str, units: str, weights: Array, relative_std: float = 0.0) -> Estimate:
        """Return a linear combination of the coefficients with its 95 % interval.

        `relative_std` is the relative standard uncertainty of a factor on the value that the residuals do not show; it
        adds in squares, at the effective degrees of freedom of Welch and Satterthwaite (GUM, G.4.1).
        """
        value, fit_std = self.combination(weights)
        std = math.hypot(fit_std, relative_std * value)
        dof = self.dof * (std / fit_std) ** 4 if fit_std > 1e-9 * std else math.inf
        half_width = t_quantile(dof) * std
        return Estimate(name, value, std, value - half_width, value + half_width, units)


@dataclass(frozen=True)
class PartialFTest:
    """F test of columns that a design lacks, such as one for each group of repeats."""

    p_value: float  # probability that scatter alone explains as much
    mean_square: float  # of the response that the extra columns explain, per degree of freedom
    dof: float  # of the extra columns

    @property
    def is_significant(self) -> bool:
        """Return whether the extra columns explain more than scatter does."""
        return self.p_value < DEPARTURE_P_VALUE


def least_squares(design: Array, response: Array, instruments: Array, error_prefix: str) -> LeastSquaresFit:
    """Fit in two stages with every point at the same weight; `error_prefix` begins the message of a failure.

    `instruments` has a column for each column of the design: the same column if it is free of error, else one that is
    correlated with it but not with its errors. Shapes: design and instruments (points, unknowns), response (points,).

    Raises
    ------
    NotIdentifiable : columns that are not independent, or no degree of freedom left for the scatter.
    """
    points, unknowns = design.shape
    if points <= unknowns:
        raise NotIdentifiable(
            f"{error_prefix}: {points} points for {unknowns} unknowns leave no degree of freedom; "
            f"{unknowns + 1} points or more are needed"
        )
    projected = instruments @ np.linalg.lstsq(instruments, design, rcond=RANK_TOLERANCE)[0]
    norms = _column_norms(projected)
    scaled_columns = projected / norms
    if _rank(scaled_columns) < unknowns:
        raise NotIdentifiable(
            f"{error_prefix}: {points} points do not tell {unknowns} unknowns apart; more levels are needed"
        )
    q, r = np.linalg.qr(scaled_columns)
    inverse = np.linalg.inv(r) / norms[:, np.newaxis]
    coefficients = inverse @ (q.T @ response)
    residuals = response - design @ coefficients
    residual_square, dof = float(residuals @ residuals), points - unknowns
    total_square = float(np.sum((response - response.mean()) ** 2))
    r_squared = 1.0 - residual_square / total_square if total_square > 0.0 else math.nan
    return LeastSquaresFit(
        coefficients, inverse @ inverse.T, projected, residuals, residual_square / dof, dof, r_squared
    )


def partial_f_test(design: Array, response: Array, extra_columns: Array) -> PartialFTest | None:
    """Test whether further columns explain more of the response than scatter (partial F test).

    With one further column for each level it is the test of lack of fit. Return None if the points leave no degree of
    freedom, the design fits exactly, or the extra columns are combinations of those of the design.
    """
    points, unknowns = design.shape
    full_design = np.hstack([design, extra_columns])
    full_design = full_design / _column_norms(full_design)
    rank = _rank(full_design)
    if rank <= unknowns or rank >= points:
        return None
    square_without = _residual_square(design / _column_norms(design), response)
    square_with = _residual_square(full_design, response)
    if square_without <= EXACT_FIT_SHARE * float(response @ response):
        return None
    from scipy.special import fdtrc

    mean_square, scatter = (square_without - square_with) / (rank - unknowns), square_with / (points - rank)
    ratio = mean_square / scatter if scatter > 0.0 else math.inf
    p_value = float(fdtrc(rank - unknowns, points - rank, ratio)) if math.isfinite(ratio) else 0.0
    return PartialFTest(p_value, mean_square, rank - unknowns)


def widened_by(fit: LeastSquaresFit, groups: PartialFTest | None) -> LeastSquaresFit:
    """Return a fit whose uncertainty follows from the scatter of group means, if the groups may differ.

    An error that belongs to a level (the curve of a sensor, the position on the circumference) is the same in every
    repeat, and an error that belongs to a run is the same in all its levels: more repeats do not average it out. If the
    groups clearly show no more than scatter, the fit is returned unchanged.
    """
    if groups is None or groups.p_value > POOLING_P_VALUE or groups.mean_square <= fit.variance:
        return fit
    return replace(fit, variance=groups.mean_square, dof=groups.dof)


def scatter_over_noise(fit: LeastSquaresFit, point_stds: Array) -> float:
    """Return the scatter about the fit over the standard errors of the points; 0 unless it is clearly above one.

    It is clearly above one if it exceeds two and has a probability under 0.001 by chi squared.
    """
    from scipy.special import chdtrc

    residual_square, noise_variance = float(fit.residuals @ fit.residuals), float(np.mean(point_stds**2))
    dof = len(fit.residuals) - len(fit.coefficients)
    if noise_variance <= 0.0:
        return 0.0
    ratio = math.sqrt(residual_square / dof / noise_variance)
    return ratio if ratio > 2.0 and chdtrc(dof, residual_square / noise_variance) < 1e-3 else 0.0


def indicator_columns(labels: npt.NDArray[np.generic]) -> Array:
    """Return columns of ones and zeros, one for each distinct label, shape (labels, distinct labels)."""
    columns: Array = (labels[:, np.newaxis] == np.unique(labels)[np.newaxis, :]).astype(np.float64)
    return columns


def _column_norms(columns: Array) -> Array:
    """Return the Euclidean norm of each column; one for a column of zeros."""
    norms: Array = np.sqrt(np.sum(columns**2, axis=0))
    norms[norms == 0.0] = 1.0
    return norms


def _rank(scaled_columns: Array) -> int:
    """Return the rank of a matrix whose columns have length one."""
    singular_values = np.linalg.svd(scaled_columns, compute_uv=False)
    return int(np.sum(singular_values > RANK_TOLERANCE * singular_values[0]))


def _residual_square(scaled_columns: Array, response: Array) -> float:
    """Return the sum of squared residuals of a response about scaled columns."""
    solution = np.linalg.lstsq(scaled_columns, response, rcond=RANK_TOLERANCE)[0]
    return float(np.sum((response - scaled_columns @ solution) ** 2))
