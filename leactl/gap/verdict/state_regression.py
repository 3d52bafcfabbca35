"""What a residual depends on: a free additive function of the logged state, learnt on some runs and tried on others.

Each variable has a piecewise linear function with knots at quantiles of the samples, and one more that turns round
with the motion; an angle has waves; speed and current have one of both together. Ridge and choice of variables come
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
"""What a function may be of, simple ones first."""
KNOTS, PAIR_KNOTS = 10, 6
FOLDS = 5
RIDGES = (1e-4, 1e-3, 1e-2, 0.1)  # of a column's power
LEAST_GAIN = 0.02  # of the gap, that a further variable must close in cross-validation
SURE = 0.975  # one-sided probability, from which on a gain on other runs is no chance


@dataclass(frozen=True, eq=False)
class Sample:
    """What one equation leaves over on some runs, with the state it was left over in."""

    left: Array
    state: Mapping[Variable, Array]
    stretch: Groups  # of runs, each cut into equal ones

    def __len__(self) -> int:
        return len(self.left)


@dataclass(frozen=True, eq=False)
class Basis:
    """Columns of one variable or of two, as the fitted runs have them."""

    key: Key
    knots: tuple[Array, ...]  # of each variable; orders of the waves of an angle

    def columns(self, sample: Sample) -> Array:
        """One row for each sample."""
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
    """Sine and cosine of some orders."""
    turned = angle[:, None] * orders[None, :]
    return np.concatenate([np.sin(turned), np.cos(turned)], axis=1)


def bases(sample: Sample, orders: Sequence[float]) -> list[Basis]:
    """Every basis that the state of some runs has; a variable that stands still has none."""
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
        if all(len(own) > 1 for own in knots):
            built.append(Basis(key, knots))
    return built


@dataclass(frozen=True, eq=False)
class Function:
    """An additive function of some variables."""

    bases: tuple[Basis, ...]
    widths: tuple[int, ...]  # columns of each
    values: Array
    scale: Array

    def of(self, sample: Sample) -> Array:
        """What it says of each sample."""
        return design(self.bases, sample) / self.scale @ self.values

    def strongest_order(self) -> float:
        """Of the waves of an angle by itself, the order with the largest coefficients; once where there are none."""
        first = 1
        for basis, width in zip(self.bases, self.widths, strict=True):
            orders = basis.knots[0]
            if basis.key == ("angle",):
                size = np.sum(self.values[first : first + width].reshape(-1, len(orders)) ** 2, axis=0)
                return float(orders[np.argmax(size)])
            first += width
        return 1.0

    @property
    def variables(self) -> tuple[Variable, ...]:
        """All variables, each once."""
        return tuple(dict.fromkeys(name for basis in self.bases for name in basis.key))


def design(chosen: Sequence[Basis], sample: Sample) -> Array:
    """A constant, then the columns of each basis."""
    return np.concatenate([np.ones((len(sample), 1)), *(basis.columns(sample) for basis in chosen)], axis=1)


class Trial:
    """Cross-validation over stretches: every fold's products of all columns, so that any choice is a small solve."""

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
        """Where the constant and the columns of some bases stand."""
        return np.concatenate([[0], *(self.places[key] for key in keys)]).astype(np.intp)

    def solve(self, gram: Array, rows: float, keys: Sequence[Key], ridge: float) -> Array:
        """Coefficients; the constant is free."""
        keep = self.columns(keys) + 1
        penalty = np.full(len(keep), ridge * rows)
        penalty[0] = 1e-9 * rows
        return np.asarray(np.linalg.solve(gram[np.ix_(keep, keep)] + np.diag(penalty), gram[keep, 0]), np.float64)

    def missed(self, keys: Sequence[Key], ridge: float) -> Array:
        """Squares that are left of each fold by what the others say."""
        whole, rows, keep = sum(self.grams), float(self.counts.sum()), self.columns(keys) + 1
        by_fold = []
        for gram, count in zip(self.grams, self.counts.tolist(), strict=True):
            values = self.solve(whole - gram, rows - count, keys, ridge)
            squares = gram[0, 0] - 2.0 * values @ gram[keep, 0] + values @ gram[np.ix_(keep, keep)] @ values
            by_fold.append(float(squares))
        return np.asarray(by_fold)

    def function(self, keys: Sequence[Key], ridge: float) -> Function:
        """The function of some bases, learnt on all folds."""
        values = self.solve(sum(self.grams), float(self.counts.sum()), keys, ridge)
        by_key = {basis.key: basis for basis in self.every}
        widths = tuple(len(self.places[key]) for key in keys)
        return Function(tuple(by_key[key] for key in keys), widths, values, self.scale[self.columns(keys)])


def _few(sample: Sample) -> Sample:
    return Sample(sample.left[:1], {name: values[:1] for name, values in sample.state.items()}, sample.stretch[:1])


def learn(sample: Sample, orders: Sequence[float], gap: float) -> tuple[Trial, list[Key], float]:
    """Choose variables one by one, each for what it closes of the gap in cross-validation, and the ridge.

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


def borne_out(trial: Trial, chosen: Sequence[Key], ridge: float, others: Sample) -> list[Key]:
    """Those variables without which the function is worse on other runs, by more than chance."""
    kept = list(chosen)
    while kept:
        whole = (others.left - trial.function(kept, ridge).of(others)) ** 2
        chances = {}
        for key in kept:
            rest = trial.function([other for other in kept if other != key], ridge)
            chances[key] = certainty((others.left - rest.of(others)) ** 2 - whole, others.stretch)
        weakest = min(kept, key=lambda key: chances[key])
        if chances[weakest] >= SURE:
            break
        kept.remove(weakest)
    return kept


def certainty(gains: Array, stretch: Groups) -> float:
    """Probability that gains are above zero on the whole, a stretch counted once; even odds where there is only one."""
    _, place = np.unique(stretch, return_inverse=True)
    sums = np.bincount(place, weights=gains)
    spread = float(np.std(sums, ddof=1)) if len(sums) > 1 else 0.0
    if spread == 0.0:
        return 0.5
    return float(stats.t.cdf(np.sqrt(len(sums)) * float(np.mean(sums)) / spread, len(sums) - 1))


def slow_gain(left: Array, stretch: Groups) -> Array:
    """Squares of each row that the stretches before and after its own explain: of what changes slowly with time."""
    gained = np.zeros(len(left))
    counts = np.bincount(stretch)
    mean = np.bincount(stretch, weights=left) / np.maximum(counts, 1)
    there = counts > 0
    for k in range(1, len(mean) - 1):
        if there[k - 1] and there[k] and there[k + 1]:
            inside = stretch == k
            expected = 0.5 * (mean[k - 1] + mean[k + 1])
            gained[inside] = left[inside] ** 2 - (left[inside] - expected) ** 2
    return gained
