"""Parameters fitted by free simulation: Levenberg and Marquardt's steps, for several models side by side.

A step of a simulation costs little more for a hundred parameter sets than for ten: models to be compared are fitted
together, several dampings of each are tried at once, and each stops for itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.servo.runs import ServoRuns
from leactl.gap.servo.simulation import SCALES, SHAPES, SIGNED, Parameters, replay, table

Array = npt.NDArray[np.float64]
ROUNDS = 25
OUTLIER_RAD = 0.03  # errors beyond count by their size, not their square: a slip at another instant is no other model
DAMPINGS = 10.0 ** np.arange(-2.0, 4.0)  # tried at once, relative to the last that helped
MOVED = 1e-3  # relative, by which a parameter is moved for a derivative
LEAST = 1e-3  # of its size, below which a positive one does not go
GAINED = 1e-4  # of the cost, below which a step is the last


class Fitting:
    """One model on its way to the least cost."""

    def __init__(self, start: Parameters, held: Sequence[str]) -> None:
        self.names = [name for name in start if name not in SHAPES and name not in held]
        self.shapes = {name: value for name, value in start.items() if name not in self.names}
        self.sizes = np.array([SCALES[name] for name in self.names])
        self.positive = np.array([name not in SIGNED for name in self.names])
        self.point = np.array([start[name] for name in self.names])
        self.damping, self.cost, self.done = 1e-2, np.inf, False
        self.error = self.tangent = np.empty(0)

    def parameters(self, point: Array) -> Parameters:
        """A point by name."""
        return self.shapes | dict(zip(self.names, point.tolist(), strict=True))

    def moves(self) -> Array:
        """How far each parameter is moved for its derivative."""
        return np.asarray(MOVED * np.maximum(np.abs(self.point), 0.1 * self.sizes), np.float64)

    def curvature(self) -> tuple[Array, Array]:
        """Weighted normal matrix, and the slope of the cost."""
        weighted = self.tangent / np.sqrt(1.0 + (self.error / OUTLIER_RAD) ** 2)
        return weighted @ self.tangent.T, weighted @ self.error

    def scores(self, run: npt.NDArray[np.intp]) -> Array:
        """Slope of the cost by run."""
        weighted = self.tangent * self.error / np.sqrt(1.0 + (self.error / OUTLIER_RAD) ** 2)
        return np.stack([np.bincount(run, weights=row) for row in weighted], axis=1)

    def trials(self) -> Array:
        """The steps of all dampings, brought back to where parameters make sense."""
        gram, slope = self.curvature()
        if not (np.isfinite(gram).all() and np.isfinite(slope).all()):
            return np.repeat(self.point[None], len(DAMPINGS), axis=0)  # nowhere to go from here
        steps = [np.linalg.solve(gram + d * np.diag(np.diag(gram) + 1e-12), slope) for d in self.damping * DAMPINGS]
        points = self.point - np.stack(steps)
        return np.asarray(np.where(self.positive, np.maximum(points, LEAST * self.sizes), points), np.float64)

    def take(self, points: Array, errors: Array) -> None:
        """Go on to the best of the trials, or stop."""
        costs = np.array([cost(one) for one in errors])
        costs[~np.isfinite(costs)] = np.inf
        best = int(np.argmin(costs))
        gained = self.cost - float(costs[best])
        self.done = not gained > GAINED * self.cost
        if gained > 0.0:
            self.point, self.error, self.cost = points[best], errors[best], float(costs[best])
            self.damping = float(self.damping * DAMPINGS[best])


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model at its least cost."""

    parameters: Parameters
    cost: float  # sum of squares of the angle's errors, outliers by their size
    error: Array  # rad, of every measured sample
    names: tuple[str, ...]  # of what was fitted
    information: Array  # normal matrix over these, per rad^2
    scores: Array  # (runs, these): each run's own slope of the cost


def fit(runs: ServoRuns, starts: Sequence[Parameters], held: Sequence[str] = ()) -> list[Fitted]:
    """Fit every parameter of each start but the shapes and those held, from where it is; all starts side by side."""
    fittings = [Fitting(start, held) for start in starts]
    for one, errors in zip(fittings, _errors(runs, fittings, [f.point[None] for f in fittings]), strict=True):
        one.error, one.cost = errors[0], cost(errors[0])
    for _ in range(ROUNDS):
        _differentiate(runs, fittings)
        going = [one for one in fittings if not one.done]
        if not going:
            break
        trials = [one.trials() for one in going]
        for one, points, errors in zip(going, trials, _errors(runs, going, trials), strict=True):
            one.take(points, errors)
    for one in fittings:
        one.done = False
    _differentiate(runs, fittings)  # where each ended
    run = np.nonzero(runs.measured)[0]
    return [
        Fitted(one.parameters(one.point), one.cost, one.error, tuple(one.names), one.curvature()[0], one.scores(run))
        for one in fittings
    ]


def cost(error: Array) -> float:
    """Sum of squares, outliers by their size (a pseudo-Huber loss)."""
    return float(2.0 * OUTLIER_RAD**2 * np.sum(np.sqrt(1.0 + (error / OUTLIER_RAD) ** 2) - 1.0))


def _differentiate(runs: ServoRuns, fittings: Sequence[Fitting]) -> None:
    going = [one for one in fittings if not one.done]
    moved = [one.point + np.diag(one.moves()) for one in going]
    for one, errors in zip(going, _errors(runs, going, moved), strict=True):
        one.tangent = (errors - one.error) / one.moves()[:, None]


def _errors(runs: ServoRuns, fittings: Sequence[Fitting], points: Sequence[Array]) -> list[Array]:
    """Of each fitting: errors (points, measured samples) at its points."""
    if not fittings:
        return []
    sets = [one.parameters(point) for one, own in zip(fittings, points, strict=True) for point in own]
    with np.errstate(over="ignore", invalid="ignore"):  # a trial may run away; it is not taken then
        wrong = (replay(runs, table(sets)) - runs.angle)[:, runs.measured]
    return np.split(wrong, np.cumsum([len(own) for own in points])[:-1])
