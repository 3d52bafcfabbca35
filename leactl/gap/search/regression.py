"""One stacked regression over all equations and runs with shared parameters.

Each equation on each run becomes a Gram matrix over its own columns; a hypothesis (a set of effect forms) is then a
small solve. Rows are weighted by the equation's noise, and counted by how many of them are independent.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.effects.contract import Form, Signals, Terms
from leactl.gap.equations.contract import FEWEST_ROWS, MEMORY, Equation, usable
from leactl.gap.signals.smoothing import thinned, thinned_index

Array = npt.NDArray[np.float64]
Column = tuple[str, ...]  # ("calibration", name), ("nuisance", run, name), ("effect", effect, form, coefficient)
Candidate = tuple[str, Form]  # effect and form
LEAST_POWER = 1e-280  # of a column, so that one that is all zero leaves numbers that are finite
LEAST_TOLD = 0.02  # of what all say of a coefficient, below which a run's own say in it does not count


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
    left_over: Array
    columns: dict[Column, Array]
    priors: dict[Column, float]
    index: npt.NDArray[np.intp]  # sample of the signals that each row is centred on
    block: npt.NDArray[np.intp]  # stretch of the run that each row lies in
    signals: Signals
    white: float  # noise as the difference of neighbours has it
    noise: float = 0.0  # standard deviation of a row
    dependence: float = 1.0  # rows per independent row
    levels: float = math.inf  # that a rounded channel takes
    rounding: float = 0.0  # standard deviation that the rounding of a channel gives a row
    width: float = 0.0  # samples, smoothing of the rows
    memory: int = MEMORY  # rows, within which one may depend on another
    rough: bool = False  # whether what is left over of them is no sign of anything
    gram: Array | None = None  # over [left_over, columns]; None where it is to be made


def make_rows(run: str, kind: str, equations: Sequence[Equation], candidates: Sequence[Candidate]) -> list[Rows | None]:
    """Smooth, thin and mask the equations of one run and every column that touches them; None of too few rows."""
    return [
        rows_of(run, kind, equation, columns)
        for equation, columns in zip(equations, effect_columns(equations, candidates), strict=True)
    ]


def rows_of(run: str, kind: str, equation: Equation, effects: dict[Column, Array]) -> Rows | None:
    """One equation with the columns of effects, which are thinned already."""
    mask = usable(equation)
    if int(mask.sum()) < FEWEST_ROWS:
        return None
    names: list[Column] = []
    raw: list[Array] = [equation.left_over]
    priors: dict[Column, float] = {}
    for name, column in equation.calibration.items():
        names.append(("calibration", name))
        raw.append(column)
    for name, (column, prior) in equation.nuisance.items():
        names.append(("nuisance", run, name))
        priors[names[-1]] = prior
        raw.append(column)
    for name, (column, prior) in equation.shared.items():
        names.append(("nuisance", "", name))
        priors[names[-1]] = prior
        raw.append(column)
    table = thinned(np.stack(raw, axis=1), equation.width, equation.step)[mask]
    index = thinned_index(len(equation.left_over), equation.width, equation.step)[mask]
    left = np.ascontiguousarray(table[:, 0])
    columns = {name: table[:, k + 1] for k, name in enumerate(names)} | effects
    interval = equation.signals.interval
    length = max(1.0, 40.0 * equation.step * interval)
    return Rows(
        run,
        equation.kind or kind,
        equation.signals.mechanical,
        equation.name,
        equation.quantity,
        equation.role,
        equation.units,
        left,
        columns,
        priors,
        index,
        (index * interval / length).astype(np.intp),
        equation.signals,
        max(white_noise(left), equation.rounding),
        levels=equation.levels,
        rounding=equation.rounding,
        width=equation.width,
        memory=equation.memory,
        rough=equation.rough,
    )


def bare(equation: Equation) -> Equation:
    """An equation that can still take effects in, without the columns that its rows have already."""
    return replace(equation, calibration={}, nuisance={}, shared={})


def effect_columns(equations: Sequence[Equation], candidates: Sequence[Candidate]) -> list[dict[Column, Array]]:
    """What effects put into the places of each equation of one run, as its rows have it.

    A form's terms are worked out once for all equations on one clock and thinned at once: all columns sample by sample
    would take far more memory than the runs.
    """
    masks = [usable(equation) for equation in equations]
    shown = [k for k, mask in enumerate(masks) if int(mask.sum()) >= FEWEST_ROWS]
    clocks = {id(equations[k].signals): equations[k].signals for k in shown}
    by_equation: list[dict[Column, Array]] = [{} for _ in equations]
    for effect, several in groupby(candidates, lambda candidate: candidate[0]):
        forms = [form for _, form in several]
        for clock, signals in clocks.items():
            for form, terms in zip(forms, library()[effect].terms_of_all(signals, forms), strict=True):
                for k in (k for k in shown if id(equations[k].signals) == clock):
                    equation, mask = equations[k], masks[k]
                    for coefficient, column in effect_in(equation, terms).items():
                        rows = thinned(column[:, None], equation.width, equation.step)[mask, 0]
                        by_equation[k]["effect", effect, repr(form), coefficient] = rows
    return by_equation


def effect_in(equation: Equation, terms: Terms) -> dict[str, Array]:
    """What an effect puts into the places of one equation, sample by sample, for each of its coefficients."""
    by_coefficient: dict[str, Array] = {}
    for place, coefficients in terms.items():
        if place not in equation.places:
            continue
        for coefficient, column in coefficients.items():
            put = equation.places[place](column)
            by_coefficient[coefficient] = by_coefficient[coefficient] + put if coefficient in by_coefficient else put
    return by_coefficient


def more_columns(rows: Rows, fresh: dict[Column, Array]) -> None:
    """Put further forms of effects beside rows that stand."""
    if not fresh:
        return
    before = np.column_stack([rows.left_over, *rows.columns.values()])
    rows.columns.update(fresh)
    if rows.gram is not None:
        table = np.column_stack(list(fresh.values()))
        cross = before.T @ table
        rows.gram = np.block([[rows.gram, cross], [cross.T, table.T @ table]])


def white_noise(values: Array) -> float:
    """Robust standard deviation of what changes from one row to the next; coarse steps count as their own noise."""
    if len(values) < 3:
        return float(np.std(values))
    change = np.abs(np.diff(values)) / np.sqrt(2.0)
    return float(max(np.median(change) / 0.6745, 0.2 * np.sqrt(np.mean(change**2)), 1e-12))


@dataclass
class Stack:
    """All rows and the Gram matrices over every column."""

    rows: list[Rows]
    names: list[Column]
    grams: list[Array]  # of each rows: over [left_over, its columns], unweighted
    local: list[npt.NDArray[np.intp]]  # where its columns stand among the names
    priors: Array  # standard deviation of each column's coefficient, inf for none
    place: dict[Column, int] = field(default_factory=dict)

    def columns_of(self, hypothesis: Sequence[Candidate]) -> npt.NDArray[np.intp]:
        """Calibration, nuisances and the hypothesis' columns."""
        wanted = {(effect, repr(form)) for effect, form in hypothesis}
        keep = [k for k, n in enumerate(self.names) if n[0] != "effect" or (n[1], n[2]) in wanted]
        return np.asarray(keep, np.intp)


def stack(rows: list[Rows], calibration_priors: dict[str, float]) -> Stack:
    """Put rows together."""
    order = {"calibration": 0, "nuisance": 1, "effect": 2}
    names = sorted({name for r in rows for name in r.columns}, key=lambda n: (order[n[0]], n[1:]))
    place = {name: k for k, name in enumerate(names)}
    priors = np.full(len(names), np.inf)
    for r in rows:
        for name, prior in r.priors.items():
            priors[place[name]] = prior
    for parameter, prior in calibration_priors.items():
        if ("calibration", parameter) in place:
            priors[place["calibration", parameter]] = prior
    grams, local = [], []
    for r in rows:
        own = list(r.columns)
        if r.gram is None:
            table = np.column_stack([r.left_over, *(r.columns[n] for n in own)])
            r.gram = table.T @ table
        grams.append(r.gram)
        local.append(np.asarray([place[n] for n in own], np.intp))
    return Stack(rows, names, grams, local, priors, place)


@dataclass
class Fit:
    """Coefficients of one hypothesis."""

    columns: npt.NDArray[np.intp]
    values: Array
    covariance: Array
    misfit: float  # weighted squares left over, priors included
    residual: dict[int, float]  # rms left over of each rows


class Normal:
    """Normal equations of a stack under given weights."""

    def __init__(self, stacked: Stack, weights: Sequence[float]) -> None:
        size = len(stacked.names)
        self.stack, self.weights = stacked, list(weights)
        self.gram, self.right, self.total = np.zeros((size, size)), np.zeros(size), 0.0
        for gram, local, weight in zip(stacked.grams, stacked.local, weights, strict=True):
            self.gram[np.ix_(local, local)] += weight * gram[1:, 1:]
            self.right[local] += weight * gram[1:, 0]
            self.total += weight * gram[0, 0]
        self.gram[np.diag_indices(size)] += 1.0 / stacked.priors**2

    def fit(self, hypothesis: Sequence[Candidate] = ()) -> Fit:
        """Solve for one hypothesis."""
        return self.solve(self.stack.columns_of(hypothesis))

    def solve(self, keep: npt.NDArray[np.intp]) -> Fit:
        """Solve for given columns."""
        gram, right = self.gram[np.ix_(keep, keep)], self.right[keep]
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        scaled = gram / np.outer(scale, scale)
        scaled[np.diag_indices(len(keep))] += 1e-10
        inverse = np.linalg.inv(scaled)
        values = inverse @ (right / scale) / scale
        with np.errstate(over="ignore"):  # a parameter without a prior that no run shows: any value is possible
            covariance = inverse / np.outer(scale, scale)
        return Fit(keep, values, covariance, self.total - float(values @ right), {})

    def residual(self, fit: Fit, index: int) -> float:
        """Root mean square left over of one rows under a fit."""
        gram, local = self.stack.grams[index], self.stack.local[index]
        full = np.zeros(len(self.stack.names))
        full[fit.columns] = fit.values
        own = np.concatenate([[1.0], -full[local]])
        return float(np.sqrt(max(own @ gram @ own, 0.0) / len(self.stack.rows[index].left_over)))


def residuals(stacked: Stack, fit: Fit, index: int) -> Array:
    """What one rows leaves over under a fit, row by row."""
    full = dict(zip((stacked.names[k] for k in fit.columns), fit.values, strict=True))
    r = stacked.rows[index]
    out = r.left_over.copy()
    for name, column in r.columns.items():
        value = full.get(name)
        if value is not None:
            out -= value * column
    return out


def disagreement(normal: Normal, fit: Fit, index: int) -> float:
    """How much further runs and equations lie apart about one coefficient than their noise says; 1 where they do not.

    Each has an optimum of its own along the direction in which the others follow that coefficient. The root of their
    chi-square over its degrees of freedom widens the standard error (Birge, 1932).
    """
    variance = fit.covariance[index, index]
    if not np.isfinite(variance):  # no run shows it
        return 1.0
    direction = np.zeros(len(normal.stack.names))
    direction[fit.columns] = fit.covariance[:, index] / variance
    full = np.zeros(len(normal.stack.names))
    full[fit.columns] = fit.values
    scores, informations = [], []
    for gram, local, weight in zip(normal.stack.grams, normal.stack.local, normal.weights, strict=True):
        along = direction[local]
        scores.append(weight * float(along @ (gram[1:, 0] - gram[1:, 1:] @ full[local])))
        informations.append(max(weight * float(along @ gram[1:, 1:] @ along), 0.0))  # of nothing, rounding may be below
    information = np.asarray(informations)
    told = information > LEAST_TOLD * information.sum()
    freedom = int(told.sum()) - 1
    if freedom < 1:
        return 1.0
    squares = float(np.sum(np.asarray(scores)[told] ** 2 / information[told]))
    return float(np.sqrt(max(squares / freedom, 1.0)))


def gain_of(normal: Normal, base: npt.NDArray[np.intp], added: npt.NDArray[np.intp]) -> tuple[float, Array, Array]:
    """Misfit that added columns take away beyond a base, with their coefficients and covariance (Frisch-Waugh)."""
    a = normal.gram[np.ix_(base, base)]
    b = normal.gram[np.ix_(base, added)]
    c = normal.gram[np.ix_(added, added)]
    known, scale = (np.sqrt(np.maximum(np.diag(gram), LEAST_POWER)) for gram in (a, c))
    ridged = a / np.outer(known, known) + 1e-12 * np.eye(len(base))
    solved = np.linalg.solve(ridged, np.column_stack([b, normal.right[base]]) / known[:, None]) / known[:, None]
    right = normal.right[added] - b.T @ solved[:, -1]
    schur = (c - b.T @ solved[:, :-1]) / np.outer(scale, scale) + 1e-9 * np.eye(len(added))
    covariance = np.linalg.inv(schur) / np.outer(scale, scale)
    values = covariance @ right
    return float(right @ values), values, np.asarray(covariance, np.float64)
