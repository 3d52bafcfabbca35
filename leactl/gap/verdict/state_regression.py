"""Regression of a residual on the logged state: a free additive function, learnt on some runs and tested on others.

Each variable has a piecewise linear function with knots at quantiles of the samples, and a second one that changes sign
with the velocity; an angle has waves; pairs of variables have products. Ridge and choice of variables come
from cross-validation over stretches of the fitted runs (Hastie, Tibshirani, 1990), so that no size or unit matters.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from leactl.gap.signals.effect_variables import hats
from leactl.vocabulary.variable import Variable

Array = npt.NDArray[np.float64]
Groups = npt.NDArray[np.intp]
Key = tuple[Variable, ...]
STATE_VARIABLES: tuple[Key, ...] = (
    ("angle",),
    ("velocity",),
    ("q_axis_current",),
    ("torque",),
    ("winding_temperature",),
    ("housing_temperature",),
    ("acceleration",),
    ("current_rate",),
    ("torque_rate",),
    ("velocity", "q_axis_current"),
    ("angle", "q_axis_current"),
)
"""Variables and pairs of variables that a function may depend on, single ones first."""
KNOTS, PAIR_KNOTS = 10, 6  # number of knots of a function of one variable, and of each variable of a pair
FOLDS = 5  # number of folds of the cross-validation
RIDGES = (1e-4, 1e-3, 1e-2, 0.1)  # ridge penalties tried, relative to a column's power
LEAST_GAIN_SHARE = 0.02  # share of the gap that a further variable closes in cross-validation
LEAST_CERTAINTY = 0.975  # one-sided probability from which a gain on other runs is no chance


@dataclass(frozen=True, eq=False)
class Sample:
    """Residual of one equation on some runs, with the logged state at each row."""

    residual: Array  # one value for each row, in the unit of the equation
    state: Mapping[Variable, Array]
    stretch: Groups  # stretch of each row; runs are cut into equal stretches

    def __len__(self) -> int:
        return len(self.residual)


@dataclass(frozen=True, eq=False)
class Basis:
    """Basis functions of one variable or of two, with knots from the fitted runs."""

    key: Key
    knots: tuple[Array, ...]  # by variable; for an angle the orders of its waves

    def columns(self, sample: Sample) -> Array:
        """Return the columns of the basis, shape (samples, functions)."""
        tables_of_variables = [
            waves(sample.state[name], knots) if name == "angle" else hats(sample.state[name], knots)
            for name, knots in zip(self.key, self.knots, strict=True)
        ]
        if len(tables_of_variables) == 2:
            return np.asarray(
                (tables_of_variables[0][:, :, None] * tables_of_variables[1][:, None, :]).reshape(len(sample), -1),
                np.float64,
            )
        velocity = sample.state.get("velocity")
        if velocity is None:
            return tables_of_variables[0]
        return np.concatenate([tables_of_variables[0], tables_of_variables[0] * np.sign(velocity)[:, None]], axis=1)


def waves(angle: Array, orders: Array) -> Array:
    """Return the sines of an angle [rad] at some orders, then its cosines, shape (samples, 2 orders)."""
    phase = angle[:, None] * orders[None, :]
    return np.concatenate([np.sin(phase), np.cos(phase)], axis=1)


def bases(sample: Sample, orders: Sequence[float]) -> list[Basis]:
    """Return every basis that the state of some runs allows; a constant variable has none."""
    allowed_bases = []
    for key in STATE_VARIABLES:
        if any(name not in sample.state for name in key):
            continue
        knot_count = KNOTS if len(key) == 1 else PAIR_KNOTS
        knots = tuple(
            np.asarray(orders, np.float64)
            if name == "angle"
            else np.unique(np.quantile(sample.state[name], np.linspace(0.0, 1.0, knot_count)))
            for name in key
        )
        if all(len(knots_of_variable) > 1 for knots_of_variable in knots):
            allowed_bases.append(Basis(key, knots))
    return allowed_bases


@dataclass(frozen=True, eq=False)
class Function:
    """Additive function of some variables with fitted coefficients."""

    bases: tuple[Basis, ...]
    widths: tuple[int, ...]  # number of columns by basis
    values: Array  # coefficient of each column, in units of its scale
    scale: Array  # root mean square of each column over the fitted runs

    def of(self, sample: Sample) -> Array:
        """Return the value of the function at each sample."""
        return design(self.bases, sample) / self.scale @ self.values

    def strongest_order(self) -> float:
        """Return the order with the largest coefficients among the waves of the angle alone; 1 without such waves."""
        first_column = 1
        for basis, width in zip(self.bases, self.widths, strict=True):
            orders = basis.knots[0]
            if basis.key == ("angle",):
                squared_amplitudes = np.sum(
                    self.values[first_column : first_column + width].reshape(-1, len(orders)) ** 2, axis=0
                )
                return float(orders[np.argmax(squared_amplitudes)])
            first_column += width
        return 1.0

    @property
    def variables(self) -> tuple[Variable, ...]:
        """All variables of the function, each once."""
        return tuple(dict.fromkeys(name for basis in self.bases for name in basis.key))


def design(chosen: Sequence[Basis], sample: Sample) -> Array:
    """Return the design matrix: a constant, then the columns of each basis."""
    return np.concatenate([np.ones((len(sample), 1)), *(basis.columns(sample) for basis in chosen)], axis=1)


class Trial:
    """Cross-validation over stretches by Gram matrices of the folds, so that any choice of bases is a small system."""

    def __init__(self, sample: Sample, all_bases: Sequence[Basis]) -> None:
        self.all_bases = list(all_bases)
        table = design(all_bases, sample)
        self.scale = np.maximum(np.sqrt(np.mean(table**2, axis=0)), 1e-300)
        table = np.column_stack([sample.residual, table / self.scale])
        fold = sample.stretch % FOLDS
        self.grams = [table[fold == k].T @ table[fold == k] for k in range(FOLDS)]
        self.counts = np.bincount(fold, minlength=FOLDS)
        first_columns = np.cumsum([1, *(basis.columns(_first_row(sample)).shape[1] for basis in all_bases)])
        self.positions = {
            b.key: np.arange(begin, end)
            for b, begin, end in zip(all_bases, first_columns[:-1], first_columns[1:], strict=True)
        }

    def columns(self, keys: Sequence[Key]) -> Groups:
        """Return the positions of the constant and the columns of some bases."""
        return np.concatenate([[0], *(self.positions[key] for key in keys)]).astype(np.intp)

    def solve(self, gram: Array, rows: float, keys: Sequence[Key], ridge: float) -> Array:
        """Return the ridge coefficients of some bases; the constant is hardly penalised.

        gram, rows : Gram matrix of some folds, residual first, and their number of rows.
        ridge : penalty relative to the power of a column.
        """
        positions = self.columns(keys) + 1
        penalty = np.full(len(positions), ridge * rows)
        penalty[0] = 1e-9 * rows
        return np.asarray(
            np.linalg.solve(gram[np.ix_(positions, positions)] + np.diag(penalty), gram[positions, 0]), np.float64
        )

    def squares_by_fold(self, keys: Sequence[Key], ridge: float) -> Array:
        """Return the squared residual of each fold under the function learnt on the other folds."""
        gram_of_all, row_count, positions = sum(self.grams), float(self.counts.sum()), self.columns(keys) + 1
        by_fold = []
        for gram, count in zip(self.grams, self.counts.tolist(), strict=True):
            values = self.solve(gram_of_all - gram, row_count - count, keys, ridge)
            squares = (
                gram[0, 0] - 2.0 * values @ gram[positions, 0] + values @ gram[np.ix_(positions, positions)] @ values
            )
            by_fold.append(float(squares))
        return np.asarray(by_fold)

    def function(self, keys: Sequence[Key], ridge: float) -> Function:
        """Return the function of some bases, learnt on all folds."""
        values = self.solve(sum(self.grams), float(self.counts.sum()), keys, ridge)
        by_key = {basis.key: basis for basis in self.all_bases}
        widths = tuple(len(self.positions[key]) for key in keys)
        return Function(tuple(by_key[key] for key in keys), widths, values, self.scale[self.columns(keys)])


def _first_row(sample: Sample) -> Sample:
    """Return the first row of a sample."""
    return Sample(sample.residual[:1], {name: values[:1] for name, values in sample.state.items()}, sample.stretch[:1])


def learn(sample: Sample, orders: Sequence[float], gap: float) -> tuple[Trial, list[Key], float]:
    """Return the trial of every basis, the chosen bases and the ridge.

    The ridge is that with the least residual in cross-validation. Bases are added one by one while the best further one
    closes `LEAST_GAIN_SHARE` of the gap there.

    gap : squares of the residual beyond noise.
    """
    trial = Trial(sample, bases(sample, orders))
    keys = [basis.key for basis in trial.all_bases]
    keys_of_one_variable = [key for key in keys if len(key) == 1]
    ridge = min(RIDGES, key=lambda tried_ridge: float(trial.squares_by_fold(keys_of_one_variable, tried_ridge).sum()))
    chosen: list[Key] = []
    squares = trial.squares_by_fold(chosen, ridge)
    while len(chosen) < len(keys):
        squares_with_key = {key: trial.squares_by_fold([*chosen, key], ridge) for key in keys if key not in chosen}
        best = min(squares_with_key, key=lambda key: float(squares_with_key[key].sum()))
        if float((squares - squares_with_key[best]).sum()) < LEAST_GAIN_SHARE * gap:
            break
        chosen, squares = [*chosen, best], squares_with_key[best]
    return trial, chosen, ridge


def confirmed_variables(trial: Trial, chosen: Sequence[Key], ridge: float, held_out: Sample) -> list[Key]:
    """Return the chosen bases without which the function is worse on held-out runs beyond chance."""
    confirmed = list(chosen)
    while confirmed:
        squares_of_all = (held_out.residual - trial.function(confirmed, ridge).of(held_out)) ** 2
        certainties = {}
        for key in confirmed:
            function_without = trial.function(
                [confirmed_key for confirmed_key in confirmed if confirmed_key != key], ridge
            )
            certainties[key] = certainty(
                (held_out.residual - function_without.of(held_out)) ** 2 - squares_of_all, held_out.stretch
            )
        weakest = min(confirmed, key=lambda key: certainties[key])
        if certainties[weakest] >= LEAST_CERTAINTY:
            break
        confirmed.remove(weakest)
    return confirmed


def certainty(gains: Array, stretch: Groups) -> float:
    """Return the probability that the mean gain is above zero, from sums over stretches; 0.5 if all are equal."""
    _, stretch_index = np.unique(stretch, return_inverse=True)
    sums = np.bincount(stretch_index, weights=gains)
    std = float(np.std(sums, ddof=1)) if len(sums) > 1 else 0.0
    if std == 0.0:
        return 0.5
    return float(stats.t.cdf(np.sqrt(len(sums)) * float(np.mean(sums)) / std, len(sums) - 1))


def slow_gain(residual: Array, stretch: Groups) -> Array:
    """Return the squares of each row that the mean of the two neighbouring stretches explains: a slow change."""
    gains = np.zeros(len(residual))
    counts = np.bincount(stretch)
    mean = np.bincount(stretch, weights=residual) / np.maximum(counts, 1)
    has_rows = counts > 0
    for k in range(1, len(mean) - 1):
        if has_rows[k - 1] and has_rows[k] and has_rows[k + 1]:
            in_stretch = stretch == k
            expected = 0.5 * (mean[k - 1] + mean[k + 1])
            gains[in_stretch] = residual[in_stretch] ** 2 - (residual[in_stretch] - expected) ** 2
    return gains
