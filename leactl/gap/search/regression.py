"""One stacked regression over all equations and runs with shared parameters.

Each equation on each run becomes a Gram matrix over its own columns, so that a hypothesis (a set of effect forms) is a
small linear system. Rows are weighted by the equation's noise and by the number of independent rows.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.effects.contract import Form, Signals, Terms
from leactl.gap.equations.contract import FEWEST_ROWS, MEMORY_ROWS, Equation, usable_rows
from leactl.gap.signals.smoothing import smoothed_and_thinned, thinned_rows

Array = npt.NDArray[np.float64]
Column = tuple[str, ...]  # ("calibration", name), ("nuisance", run, name), ("effect", effect, form, coefficient)
Candidate = tuple[str, Form]  # effect and form
LEAST_POWER = 1e-280  # smallest power of a column, so that a column of zeros gives finite numbers
LEAST_INFORMATION_SHARE = 0.02  # share of all information on a coefficient below which a run does not count


@dataclass
class Rows:
    """Rows of one equation on one run."""

    run: str
    kind: str
    mechanical: str
    equation: str
    quantity: str
    role: str
    units: str
    left_over: Array  # residual of the nominal model, one value for each row
    columns: dict[Column, Array]
    priors: dict[Column, float]
    index: npt.NDArray[np.intp]  # sample of the signals that each row is centred on
    block: npt.NDArray[np.intp]  # stretch of the run that each row lies in
    signals: Signals
    white_noise: float  # standard deviation of the noise from row to row, by differences of neighbours
    noise: float = 0.0  # standard deviation of a row
    dependence: float = 1.0  # rows per independent row
    levels: float = math.inf  # number of levels of a rounded channel
    rounding: float = 0.0  # standard deviation that the rounding of a channel gives a row
    width: float = 0.0  # samples, smoothing of the rows
    memory: int = MEMORY_ROWS  # rows within which one may depend on another
    rough: bool = False  # whether the equation is so rough that its residual cannot be judged
    gram: Array | None = None  # over [left_over, columns]; None where not yet computed


def make_rows(run: str, kind: str, equations: Sequence[Equation], candidates: Sequence[Candidate]) -> list[Rows | None]:
    """Return the rows of each equation of one run, smoothed, thinned and masked; None where they are too few."""
    return [
        rows_of(run, kind, equation, columns)
        for equation, columns in zip(equations, effect_columns(equations, candidates), strict=True)
    ]


def rows_of(run: str, kind: str, equation: Equation, effects: dict[Column, Array]) -> Rows | None:
    """Return the rows of one equation; None where they are too few.

    effects : columns of effects, thinned already.
    """
    mask = usable_rows(equation)
    if int(mask.sum()) < FEWEST_ROWS:
        return None
    names: list[Column] = []
    unsmoothed_columns: list[Array] = [equation.left_over]
    priors: dict[Column, float] = {}
    for name, column in equation.calibration.items():
        names.append(("calibration", name))
        unsmoothed_columns.append(column)
    for name, (column, prior) in equation.nuisance.items():
        names.append(("nuisance", run, name))
        priors[names[-1]] = prior
        unsmoothed_columns.append(column)
    for name, (column, prior) in equation.shared.items():
        names.append(("nuisance", "", name))
        priors[names[-1]] = prior
        unsmoothed_columns.append(column)
    table = smoothed_and_thinned(np.stack(unsmoothed_columns, axis=1), equation.width, equation.step)[mask]
    index = thinned_rows(len(equation.left_over), equation.width, equation.step)[mask]
    left_over = np.ascontiguousarray(table[:, 0])
    columns = {name: table[:, k + 1] for k, name in enumerate(names)} | effects
    interval = equation.signals.interval
    # s: a block has 40 rows or more, and lasts a second or more
    block_duration = max(1.0, 40.0 * equation.step * interval)
    return Rows(
        run,
        equation.kind or kind,
        equation.signals.mechanical,
        equation.name,
        equation.quantity,
        equation.role,
        equation.units,
        left_over,
        columns,
        priors,
        index,
        (index * interval / block_duration).astype(np.intp),
        equation.signals,
        max(white_noise(left_over), equation.rounding),
        levels=equation.levels,
        rounding=equation.rounding,
        width=equation.width,
        memory=equation.memory,
        rough=equation.rough,
    )


def without_model_columns(equation: Equation) -> Equation:
    """Return an equation without its calibration and nuisance columns; effects can still be added to it."""
    return replace(equation, calibration={}, nuisance={}, shared={})


def effect_columns(equations: Sequence[Equation], candidates: Sequence[Candidate]) -> list[dict[Column, Array]]:
    """Return the columns of effects in each equation of one run, smoothed and thinned as its rows are.

    A form's terms are computed once for all equations on one clock and thinned at once: all columns at the full rate
    would take far more memory than the runs.
    """
    masks = [usable_rows(equation) for equation in equations]
    with_rows = [k for k, mask in enumerate(masks) if int(mask.sum()) >= FEWEST_ROWS]
    clocks = {id(equations[k].signals): equations[k].signals for k in with_rows}
    by_equation: list[dict[Column, Array]] = [{} for _ in equations]
    for effect, candidates_of_effect in groupby(candidates, lambda candidate: candidate[0]):
        forms = [form for _, form in candidates_of_effect]
        for clock, signals in clocks.items():
            for form, terms in zip(forms, library()[effect].terms_of_all(signals, forms), strict=True):
                for k in (k for k in with_rows if id(equations[k].signals) == clock):
                    equation, mask = equations[k], masks[k]
                    for coefficient, column in effect_contributions(equation, terms).items():
                        column_of_rows = smoothed_and_thinned(column[:, None], equation.width, equation.step)[mask, 0]
                        by_equation[k]["effect", effect, repr(form), coefficient] = column_of_rows
    return by_equation


def effect_contributions(equation: Equation, terms: Terms) -> dict[str, Array]:
    """Return the contribution of an effect to one equation at the full rate, by coefficient."""
    by_coefficient: dict[str, Array] = {}
    for place, coefficients in terms.items():
        if place not in equation.places:
            continue
        for coefficient, column in coefficients.items():
            contribution = equation.places[place](column)
            by_coefficient[coefficient] = (
                by_coefficient[coefficient] + contribution if coefficient in by_coefficient else contribution
            )
    return by_coefficient


def add_columns(rows: Rows, further_columns: dict[Column, Array]) -> None:
    """Add columns of further forms of effects to rows, and extend their Gram matrix."""
    if not further_columns:
        return
    present_table = np.column_stack([rows.left_over, *rows.columns.values()])
    rows.columns.update(further_columns)
    if rows.gram is not None:
        further_table = np.column_stack(list(further_columns.values()))
        cross_gram = present_table.T @ further_table
        rows.gram = np.block([[rows.gram, cross_gram], [cross_gram.T, further_table.T @ further_table]])


def white_noise(values: Array) -> float:
    """Return the robust standard deviation of the noise from row to row; coarse steps count as noise."""
    if len(values) < 3:
        return float(np.std(values))
    differences = np.abs(np.diff(values)) / np.sqrt(2.0)
    # the median of |x| is 0.6745 for unit normal x
    return float(max(np.median(differences) / 0.6745, 0.2 * np.sqrt(np.mean(differences**2)), 1e-12))


@dataclass
class Stack:
    """All rows, with their Gram matrices and the names of all columns."""

    rows: list[Rows]
    names: list[Column]
    grams: list[Array]  # by group of rows: over [left_over, its columns], unweighted
    local: list[npt.NDArray[np.intp]]  # by group of rows: positions of its columns in the names
    priors: Array  # standard deviation of each column's coefficient; infinite without a prior
    position_of: dict[Column, int] = field(default_factory=dict)

    def columns_of(self, hypothesis: Sequence[Candidate]) -> npt.NDArray[np.intp]:
        """Return the positions of all columns but those of effects outside a hypothesis."""
        effects_and_forms = {(effect, repr(form)) for effect, form in hypothesis}
        positions = [
            k for k, name in enumerate(self.names) if name[0] != "effect" or (name[1], name[2]) in effects_and_forms
        ]
        return np.asarray(positions, np.intp)


def stack(rows: list[Rows], calibration_priors: dict[str, float]) -> Stack:
    """Return groups of rows as one stack, and compute the Gram matrices that they lack."""
    order = {"calibration": 0, "nuisance": 1, "effect": 2}
    names = sorted({name for group in rows for name in group.columns}, key=lambda name: (order[name[0]], name[1:]))
    position_of = {name: k for k, name in enumerate(names)}
    priors = np.full(len(names), np.inf)
    for group in rows:
        for name, prior in group.priors.items():
            priors[position_of[name]] = prior
    for parameter, prior in calibration_priors.items():
        if ("calibration", parameter) in position_of:
            priors[position_of["calibration", parameter]] = prior
    grams, local = [], []
    for group in rows:
        names_of_group = list(group.columns)
        if group.gram is None:
            table = np.column_stack([group.left_over, *(group.columns[name] for name in names_of_group)])
            group.gram = table.T @ table
        grams.append(group.gram)
        local.append(np.asarray([position_of[name] for name in names_of_group], np.intp))
    return Stack(rows, names, grams, local, priors, position_of)


@dataclass
class Fit:
    """Coefficients of one hypothesis."""

    columns: npt.NDArray[np.intp]  # positions in the stack of the columns that are fitted
    values: Array  # coefficient of each of these columns
    covariance: Array  # of the coefficients
    misfit: float  # weighted squared residuals, priors included


class Normal:
    """Normal equations of a stack under given weights."""

    def __init__(self, stacked: Stack, weights: Sequence[float]) -> None:
        size = len(stacked.names)
        # products of the columns with each other and with the left-over, and squares of the left-over
        self.stack, self.weights = stacked, list(weights)
        self.gram, self.right, self.total = np.zeros((size, size)), np.zeros(size), 0.0
        for gram, local, weight in zip(stacked.grams, stacked.local, weights, strict=True):
            self.gram[np.ix_(local, local)] += weight * gram[1:, 1:]
            self.right[local] += weight * gram[1:, 0]
            self.total += weight * gram[0, 0]
        self.gram[np.diag_indices(size)] += 1.0 / stacked.priors**2

    def fit(self, hypothesis: Sequence[Candidate] = ()) -> Fit:
        """Return the fit of one hypothesis; without effects, of calibration and nuisances alone."""
        return self.solve(self.stack.columns_of(hypothesis))

    def solve(self, columns: npt.NDArray[np.intp]) -> Fit:
        """Return the fit of the columns at some positions of the stack."""
        gram, right = self.gram[np.ix_(columns, columns)], self.right[columns]
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        scaled = gram / np.outer(scale, scale)
        scaled[np.diag_indices(len(columns))] += 1e-10  # equal columns would make the matrix singular
        inverse = np.linalg.inv(scaled)
        values = inverse @ (right / scale) / scale
        with np.errstate(over="ignore"):  # a parameter without a prior that no run shows has an infinite variance
            covariance = inverse / np.outer(scale, scale)
        return Fit(columns, values, covariance, self.total - float(values @ right))

    def residual_rms(self, fit: Fit, index: int) -> float:
        """Return the root mean square residual of one group of rows under a fit."""
        gram, local = self.stack.grams[index], self.stack.local[index]
        coefficients = np.zeros(len(self.stack.names))
        coefficients[fit.columns] = fit.values
        combination = np.concatenate([[1.0], -coefficients[local]])
        return float(np.sqrt(max(combination @ gram @ combination, 0.0) / len(self.stack.rows[index].left_over)))


def residuals(stacked: Stack, fit: Fit, index: int) -> Array:
    """Return the residual of each row of one group under a fit."""
    coefficients = dict(zip((stacked.names[k] for k in fit.columns), fit.values, strict=True))
    group = stacked.rows[index]
    residual = group.left_over.copy()
    for name, column in group.columns.items():
        value = coefficients.get(name)
        if value is not None:
            residual -= value * column
    return residual


def disagreement(normal: Normal, fit: Fit, index: int) -> float:
    """Return the factor by which runs and equations disagree about one coefficient beyond their noise, at least 1.

    Each group of rows has its own optimum along the direction in which the other coefficients follow that one. The root
    of their chi-square over its degrees of freedom widens the standard error (Birge, 1932).

    index : position of the coefficient in the fit.
    """
    variance = fit.covariance[index, index]
    if not np.isfinite(variance):  # no run shows the coefficient
        return 1.0
    direction = np.zeros(len(normal.stack.names))
    direction[fit.columns] = fit.covariance[:, index] / variance
    coefficients = np.zeros(len(normal.stack.names))
    coefficients[fit.columns] = fit.values
    scores, informations = [], []
    for gram, local, weight in zip(normal.stack.grams, normal.stack.local, normal.weights, strict=True):
        local_direction = direction[local]
        scores.append(weight * float(local_direction @ (gram[1:, 0] - gram[1:, 1:] @ coefficients[local])))
        # rounding may make zero negative
        informations.append(max(weight * float(local_direction @ gram[1:, 1:] @ local_direction), 0.0))
    information = np.asarray(informations)
    informative = information > LEAST_INFORMATION_SHARE * information.sum()
    degrees_of_freedom = int(informative.sum()) - 1
    if degrees_of_freedom < 1:
        return 1.0
    chi_square = float(np.sum(np.asarray(scores)[informative] ** 2 / information[informative]))
    return float(np.sqrt(max(chi_square / degrees_of_freedom, 1.0)))


def gain_of(normal: Normal, base: npt.NDArray[np.intp], added: npt.NDArray[np.intp]) -> tuple[float, Array, Array]:
    """Return by how much added columns lower a base's misfit, their coefficients, and the covariance (Frisch-Waugh)."""
    base_gram = normal.gram[np.ix_(base, base)]
    cross_gram = normal.gram[np.ix_(base, added)]
    added_gram = normal.gram[np.ix_(added, added)]
    base_scale, added_scale = (np.sqrt(np.maximum(np.diag(gram), LEAST_POWER)) for gram in (base_gram, added_gram))
    base_correlation = base_gram / np.outer(base_scale, base_scale) + 1e-12 * np.eye(len(base))
    base_coefficients = (
        np.linalg.solve(base_correlation, np.column_stack([cross_gram, normal.right[base]]) / base_scale[:, None])
        / base_scale[:, None]
    )
    right = normal.right[added] - cross_gram.T @ base_coefficients[:, -1]
    schur = (added_gram - cross_gram.T @ base_coefficients[:, :-1]) / np.outer(
        added_scale, added_scale
    ) + 1e-9 * np.eye(len(added))
    covariance = np.linalg.inv(schur) / np.outer(added_scale, added_scale)
    values = covariance @ right
    return float(right @ values), values, np.asarray(covariance, np.float64)
