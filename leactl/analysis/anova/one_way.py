"""One-way analysis of variance over conditions; the actuator is a random factor if there are several.

    y = mean + condition + actuator + (condition x actuator) + error

Sums of squares are differences between residuals of nested models, conditions adjusted for actuators: without the
interaction the ratio follows F exactly, however unequal the numbers of values. With it, expected mean squares are E =
variance of the error + c x variance of the interaction, c = trace(Q Z Z') / degrees of freedom; the denominator
combines interaction and error so that both expectations agree, with Satterthwaite's degrees of freedom. In a balanced
design it is the mean square of the interaction. (Searle, Casella and McCulloch, Variance Components, 1992, chapters 4
and 5.)

F assumes equal scatter under all conditions; if it is twice as large under one of three, chance alone shows an effect
in 6 % of cases instead of 5 %. An effect is therefore claimed only if Welch's test, which does not assume equal
scatter, shows it too (Biometrika 38, 1951).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.analysis.anova.values import Array, Values
from leactl.errors import NotIdentifiable

FEWEST_VALUES_FOR_WELCH = 4  # under a condition; fewer do not determine its scatter well enough
SIGNIFICANCE = 0.05  # probability by chance below which a difference counts as shown; as in the paper


@dataclass(frozen=True)
class FTest:
    """F test: a ratio of mean squares, its degrees of freedom, and the probability of so large a ratio by chance."""

    f: float
    between: float  # degrees of freedom of the numerator
    within: float  # degrees of freedom of the denominator
    p: float

    @property
    def shown(self) -> bool:
        """Return whether the ratio is more than chance."""
        return self.p < SIGNIFICANCE


@dataclass(frozen=True, eq=False)
class Design:
    """Design matrices of indicator columns, shape (values, columns): for conditions, actuators and their cells."""

    conditions: tuple[str, ...]
    actuators: tuple[str, ...]
    condition: Array  # a column for each condition
    actuator: Array  # a column for each actuator
    cell: Array  # a column for each actuator under each condition that has values

    @property
    def additive(self) -> Array:
        """Return the columns of conditions and actuators side by side."""
        return np.hstack([self.condition, self.actuator])


@dataclass(frozen=True, eq=False)
class Anova:
    """Result of an analysis of variance; `actuator` and `interaction` are None if they cannot be tested."""

    design: Design
    test: FTest  # of the conditions; its error is also that of the pairwise differences
    error: "ErrorTerm"
    actuator: FTest | None
    actuator_std: float | None  # standard deviation between actuators
    interaction: FTest | None
    at_large: FTest | None  # of the conditions, for all actuators of this make
    residuals: Array  # about the fitted effects of conditions and actuators, shape (values,)
    unequal: FTest | None = None  # Welch's test; None if it has too few values, or the interaction is the error

    @property
    def shown(self) -> bool:
        """Return whether the effect of the condition is more than chance, with and without assuming equal scatter."""
        return self.test.shown and (self.unequal is None or self.unequal.shown)


@dataclass(frozen=True)
class ErrorTerm:
    """Mean squares that a difference is tested against: the error, and the interaction if it is significant."""

    mean_square: float
    dof: float
    interaction: tuple[float, float, float] | None = None  # mean square, degrees of freedom, c


def anova(values: Values) -> Anova:
    """Return the analysis of variance of one result over the conditions.

    Raises
    ------
    NotIdentifiable : fewer than two conditions, no repeats, no scatter, or conditions confounded with actuators.
    """
    design = design_of(values)
    y, count = values.value, len(values.value)
    actuator_residuals, actuator_rank = _residual(design.actuator, y)
    additive_residuals, additive_rank = _residual(design.additive, y)
    if additive_rank - actuator_rank < len(design.conditions) - 1:
        raise NotIdentifiable(
            f"{values.name}: conditions and actuators cannot be told apart: no actuator was measured under all of the"
            " conditions that are to be compared"
        )
    if count - additive_rank < 1:
        raise NotIdentifiable(
            f"{values.name}: {count} values of {_size_text(design)} give no scatter to judge by; repeat one run or more"
            " under a condition, or measure a further actuator under each"
        )
    error = ErrorTerm(_square_sum(additive_residuals) / (count - additive_rank), count - additive_rank)
    if not error.mean_square > 1e-24 * float(np.max(np.abs(y))) ** 2:
        raise NotIdentifiable(
            f"{values.name}: the repeats are equal to the last digit; there is no scatter to judge by"
        )
    condition_mean_square = (_square_sum(actuator_residuals) - _square_sum(additive_residuals)) / (
        additive_rank - actuator_rank
    )
    test = f_test(condition_mean_square, additive_rank - actuator_rank, error.mean_square, error.dof)
    values_without_actuators = _without_actuators(design, y)
    welch_test = welch([values_without_actuators[values.condition == condition] for condition in design.conditions])
    if len(design.actuators) < 2:
        return Anova(design, test, error, None, None, None, None, additive_residuals, welch_test)
    condition_residuals, condition_rank = _residual(design.condition, y)
    actuator_mean_square = (_square_sum(condition_residuals) - _square_sum(additive_residuals)) / (
        additive_rank - condition_rank
    )
    actuator_factor = _trace(design.condition, design.additive, design.actuator) / (additive_rank - condition_rank)
    actuator_std = math.sqrt(max(actuator_mean_square - error.mean_square, 0.0) / actuator_factor)
    actuator = f_test(actuator_mean_square, additive_rank - condition_rank, error.mean_square, error.dof)
    cell_residuals, cell_rank = _residual(design.cell, y)
    if cell_rank == additive_rank:
        return Anova(design, test, error, actuator, actuator_std, None, None, additive_residuals, welch_test)
    interaction_mean_square = (_square_sum(additive_residuals) - _square_sum(cell_residuals)) / (
        cell_rank - additive_rank
    )
    if count == cell_rank:
        return Anova(design, test, error, actuator, actuator_std, None, test, additive_residuals, welch_test)
    cell_error = ErrorTerm(
        _square_sum(cell_residuals) / (count - cell_rank),
        count - cell_rank,
        (
            interaction_mean_square,
            cell_rank - additive_rank,
            _trace(design.additive, design.cell, design.cell) / (cell_rank - additive_rank),
        ),
    )
    interaction = f_test(interaction_mean_square, cell_rank - additive_rank, cell_error.mean_square, cell_error.dof)
    interaction_factor = _trace(design.actuator, design.additive, design.cell) / (additive_rank - actuator_rank)
    at_large = f_test(
        condition_mean_square, additive_rank - actuator_rank, *combined_error(cell_error, 1.0, interaction_factor)
    )
    if interaction.shown:
        return Anova(design, at_large, cell_error, actuator, actuator_std, interaction, at_large, additive_residuals)
    return Anova(design, test, error, actuator, actuator_std, interaction, at_large, additive_residuals, welch_test)


def combined_error(error: ErrorTerm, error_factor: float, interaction_factor: float) -> tuple[float, float]:
    """Return the variance error_factor x error + interaction_factor x interaction, and its degrees of freedom.

    The degrees of freedom are Satterthwaite's.
    """
    if error.interaction is None:
        return error_factor * error.mean_square, error.dof
    mean_square, dof, c = error.interaction
    terms = [
        ((error_factor - interaction_factor / c) * error.mean_square, error.dof),
        (interaction_factor / c * mean_square, dof),
    ]
    variance = sum(term for term, _ in terms)
    if variance <= 0.0:  # an interaction smaller than its error by chance
        return error_factor * error.mean_square, error.dof
    return variance, variance**2 / sum(term**2 / term_dof for term, term_dof in terms)


def f_test(numerator: float, between: float, denominator: float, within: float) -> FTest:
    """Return the F test of a ratio of mean squares with `between` and `within` degrees of freedom."""
    from scipy.stats import f

    ratio = numerator / denominator
    return FTest(ratio, between, within, float(f.sf(ratio, between, within)))


def welch(groups: Sequence[Array]) -> FTest | None:
    """Return Welch's test of equal means; None if a group has fewer than `FEWEST_VALUES_FOR_WELCH` or no scatter."""
    if min(map(len, groups)) < FEWEST_VALUES_FOR_WELCH or min(float(np.ptp(group)) for group in groups) == 0.0:
        return None
    counts = np.array([len(group) for group in groups])
    means = np.array([group.mean() for group in groups])
    variances = np.array([group.var(ddof=1) for group in groups])
    weights = counts / variances
    shares = weights / weights.sum()
    between = len(groups) - 1.0
    loss = float(np.sum((1.0 - shares) ** 2 / (counts - 1.0))) / (between * (between + 2.0))
    between_square = float(weights @ (means - shares @ means) ** 2) / between
    return f_test(between_square, between, 1.0 + 2.0 * (between - 1.0) * loss, 1.0 / (3.0 * loss))


def design_of(values: Values) -> Design:
    """Return the design matrices for the labels of values.

    Raises
    ------
    NotIdentifiable : fewer than two conditions.
    """
    conditions, actuators = (tuple(dict.fromkeys(labels.tolist())) for labels in (values.condition, values.actuator))
    if len(conditions) < 2:
        description = f"one condition, '{conditions[0]}'" if conditions else "no value"
        raise NotIdentifiable(f"{values.name}: found {description}; two conditions or more are needed")
    condition = _indicator_columns(values.condition, conditions)
    actuator = _indicator_columns(values.actuator, actuators)
    cell = np.hstack([condition * column[:, np.newaxis] for column in actuator.T])
    return Design(conditions, actuators, condition, actuator, cell[:, cell.any(axis=0)])


def _indicator_columns(labels: npt.NDArray[np.str_], distinct_labels: tuple[str, ...]) -> Array:
    """Return a column for each distinct label that is one where a value has the label, else zero."""
    return np.stack([(labels == label).astype(np.float64) for label in distinct_labels], axis=1)


def _residual(columns: Array, y: Array) -> tuple[Array, int]:
    """Return the residuals of values about columns, and the rank of the columns."""
    basis = _basis(columns)
    return y - basis @ (basis.T @ y), basis.shape[1]


def _without_actuators(design: Design, y: Array) -> Array:
    """Return the values without the fitted effects of the actuators."""
    coefficients = np.linalg.pinv(design.additive) @ y
    return np.asarray(y - design.actuator @ coefficients[len(design.conditions) :], np.float64)


def _square_sum(values: Array) -> float:
    """Return the sum of the squared values."""
    return float(values @ values)


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis of the space that the columns span."""
    vectors, singular_values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(vectors[:, singular_values > 1e-9 * singular_values[0]], np.float64)


def _trace(smaller: Array, larger: Array, factor: Array) -> float:
    """Return trace(Q Z Z'), where Z are the columns of a factor.

    Q projects onto the space that the larger columns span and the smaller columns do not.
    """
    return float(np.sum((_basis(larger).T @ factor) ** 2) - np.sum((_basis(smaller).T @ factor) ** 2))


def _size_text(design: Design) -> str:
    """Return a text with the numbers of conditions and actuators."""
    actuators = f" and {len(design.actuators)} actuators" if len(design.actuators) > 1 else ""
    return f"{len(design.conditions)} conditions{actuators}"
