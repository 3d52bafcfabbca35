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
STATE: tuple[Key, ...] = (
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
"""Variables that a function may depend on, simple ones first."""
KNOTS, PAIR_KNOTS = 10, 6  # knots of a function of one variable, and of each variable of a pair
FOLDS = 5  # of the cross-validation
RIDGES = (1e-4, 1e-3, 1e-2, 0.1)  # ridge penalties tried, relative to a column's power
LEAST_GAIN = 0.02  # share of the gap that a further variable closes in cross-validation
LEAST_CERTAINTY = 0.975  # one-sided probability from which a gain on other runs is no chance


@dataclass(frozen=True, eq=False)
class Sample:
    """Residual of one equation on some runs, with the logged state at each row."""

    left: Array
    state: Mapping[Variable, Array]
    stretch: Groups  # stretch of each row; runs are cut into equal stretches

    def __len__(self) -> int:
        return len(self.left)


@dataclass(frozen=True, eq=False)
class Basis:
    """Basis functions of one variable or of two, with knots from the fitted runs."""

    key: Key
    knots: tuple[Array, ...]  # by variable; for an angle the orders of its waves

    def columns(self, sample: Sample) -> Array:
        """Return the columns of the basis, one row for each sample."""
        parts = [
            waves(sample.state[name], knots) if name == "angle" else hats(sample.state[name], knots)
            for name, knots in zip(self.key, self.knots, strict=True)
        ]
        if len(parts) == 2:
            return np.asarray((parts[0][:, :, None] * parts[1][:, None, :]).reshape(len(sample), -1), np.float64)
        turning = sample.state.get("velocity")
        if turning is None:
            return parts[0]
        return np.concatenate([parts[0], parts[0] * np.sign(turning)[:, None]], axis=1)


def waves(angle: Array, orders: Array) -> Array:
    """Return sine and cosine of an angle at some orders."""
    phase = angle[:, None] * orders[None, :]
    return np.concatenate([np.sin(phase), np.cos(phase)], axis=1)


def bases(sample: Sample, orders: Sequence[float]) -> list[Basis]:
    """Return every basis that the state of some runs allows; a constant variable has none."""
    built = []
    for key in STATE:
        if any(name not in sample.state for name in key):
            continue
        count = KNOTS if len(key) == 1 else PAIR_KNOTS
        knots = tuple(
            np.asarray(orders, np.float64)
            if name == "angle"
            else np.unique(np.quantile(sample.state[name], np.linspace(0.0, 1.0, count)))
            for name in key
        )
        if all(len(knots_of_variable) > 1 for knots_of_variable in knots):
            built.append(Basis(key, knots))
    return built


@dataclass(frozen=True, eq=False)
class Function:
    """Additive function of some variables with fitted coefficients."""

    bases: tuple[Basis, ...]
    widths: tuple[int, ...]  # number of columns by basis
    values: Array
    scale: Array

    def of(self, sample: Sample) -> Array:
        """Return the value of the function at each sample."""
        return design(self.bases, sample) / self.scale @ self.values

    def strongest_order(self) -> float:
        """Return the order with the largest coefficients among the waves of the angle alone; 1 without such waves."""
        begin = 1
        for basis, width in zip(self.bases, self.widths, strict=True):
            orders = basis.knots[0]
            if basis.key == ("angle",):
                size = np.sum(self.values[begin : begin + width].reshape(-1, len(orders)) ** 2, axis=0)
                return float(orders[np.argmax(size)])
            begin += width
        return 1.0

    @property
    def variables(self) -> tuple[Variable, ...]:
        """All variables of the function, each once."""
        return tuple(dict.fromkeys(name for basis in self.bases for name in basis.key))


def design(chosen: Sequence[Basis], sample: Sample) -> Array:
    """Return the design matrix: a constant, then the columns of each basis."""
    return np.concatenate([np.ones((len(sample), 1)), *(basis.columns(sample) for basis in chosen)], axis=1)


class Trial:
    """Cross-validation over stretches from the Gram matrix of every fold, so that any choice is a small system."""

    def __init__(self, sample: Sample, every: Sequence[Basis]) -> None:
        self.every = list(every)
        table = design(every, sample)
        self.scale = np.maximum(np.sqrt(np.mean(table**2, axis=0)), 1e-300)
        table = np.column_stack([sample.left, table / self.scale])
        fold = sample.stretch % FOLDS
        self.grams = [table[fold == k].T @ table[fold == k] for k in range(FOLDS)]
        self.counts = np.bincount(fold, minlength=FOLDS)
        ends = np.cumsum([1, *(basis.columns(_few(sample)).shape[1] for basis in every)])
        self.places = {b.key: np.arange(a, c) for b, a, c in zip(every, ends[:-1], ends[1:], strict=True)}

    def columns(self, keys: Sequence[Key]) -> Groups:
        """Return the positions of the constant and the columns of some bases."""
        return np.concatenate([[0], *(self.places[key] for key in keys)]).astype(np.intp)

    def solve(self, gram: Array, rows: float, keys: Sequence[Key], ridge: float) -> Array:
        """Return the ridge coefficients of some bases; the constant is not penalised."""
        keep = self.columns(keys) + 1
        penalty = np.full(len(keep), ridge * rows)
        penalty[0] = 1e-9 * rows
        return np.asarray(np.linalg.solve(gram[np.ix_(keep, keep)] + np.diag(penalty), gram[keep, 0]), np.float64)

    def missed(self, keys: Sequence[Key], ridge: float) -> Array:
        """Return the squared residual of each fold under the function learnt on the others."""
        gram_of_all, rows, keep = sum(self.grams), float(self.counts.sum()), self.columns(keys) + 1
        by_fold = []
        for gram, count in zip(self.grams, self.counts.tolist(), strict=True):
            values = self.solve(gram_of_all - gram, rows - count, keys, ridge)
            squares = gram[0, 0] - 2.0 * values @ gram[keep, 0] + values @ gram[np.ix_(keep, keep)] @ values
            by_fold.append(float(squares))
        return np.asarray(by_fold)

    def function(self, keys: Sequence[Key], ridge: float) -> Function:
        """Return the function of some bases, learnt on all folds."""
        values = self.solve(sum(self.grams), float(self.counts.sum()), keys, ridge)
        by_key = {basis.key: basis for basis in self.every}
        widths = tuple(len(self.places[key]) for key in keys)
        return Function(tuple(by_key[key] for key in keys), widths, values, self.scale[self.columns(keys)])


def _few(sample: Sample) -> Sample:
    return Sample(sample.left[:1], {name: values[:1] for name, values in sample.state.items()}, sample.stretch[:1])


def learn(sample: Sample, orders: Sequence[float], gap: float) -> tuple[Trial, list[Key], float]:
    """Choose the ridge, and variables one by one by the share of the gap they close in cross-validation.

    gap : squares beyond noise.
    """
    trial = Trial(sample, bases(sample, orders))
    keys = [basis.key for basis in trial.every]
    singles = [key for key in keys if len(key) == 1]
    ridge = min(RIDGES, key=lambda tried: float(trial.missed(singles, tried).sum()))
    chosen: list[Key] = []
    missed = trial.missed(chosen, ridge)
    while len(chosen) < len(keys):
        tried = {key: trial.missed([*chosen, key], ridge) for key in keys if key not in chosen}
        best = min(tried, key=lambda key: float(tried[key].sum()))
        if float((missed - tried[best]).sum()) < LEAST_GAIN * gap:
            break
        chosen, missed = [*chosen, best], tried[best]
    return trial, chosen, ridge


def confirmed_variables(trial: Trial, chosen: Sequence[Key], ridge: float, held_out: Sample) -> list[Key]:
    """Return the chosen variables without which the function is worse on held-out runs beyond chance."""
    confirmed = list(chosen)
    while confirmed:
        squares_of_all = (held_out.left - trial.function(confirmed, ridge).of(held_out)) ** 2
        chances = {}
        for key in confirmed:
            function_without = trial.function(
                [confirmed_key for confirmed_key in confirmed if confirmed_key != key], ridge
            )
            chances[key] = certainty(
                (held_out.left - function_without.of(held_out)) ** 2 - squares_of_all, held_out.stretch
            )
        weakest = min(confirmed, key=lambda key: chances[key])
        if chances[weakest] >= LEAST_CERTAINTY:
            break
        confirmed.remove(weakest)
    return confirmed


def certainty(gains: Array, stretch: Groups) -> float:
    """Return the probability that the mean gain is above zero, from sums over stretches; 0.5 for a single stretch."""
    _, group = np.unique(stretch, return_inverse=True)
    sums = np.bincount(group, weights=gains)
    spread = float(np.std(sums, ddof=1)) if len(sums) > 1 else 0.0
    if spread == 0.0:
        return 0.5
    return float(stats.t.cdf(np.sqrt(len(sums)) * float(np.mean(sums)) / spread, len(sums) - 1))


def slow_gain(residual: Array, stretch: Groups) -> Array:
    """Return the squares of each row that the mean of the two neighbouring stretches explains: a slow change."""
    gained = np.zeros(len(residual))
    counts = np.bincount(stretch)
    mean = np.bincount(stretch, weights=residual) / np.maximum(counts, 1)
    present = counts > 0
    for k in range(1, len(mean) - 1):
        if present[k - 1] and present[k] and present[k + 1]:
            inside = stretch == k
            expected = 0.5 * (mean[k - 1] + mean[k + 1])
            gained[inside] = residual[inside] ** 2 - (residual[inside] - expected) ** 2
    return gained
