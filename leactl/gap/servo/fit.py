"""Parameters fitted by free simulation: Levenberg and Marquardt's steps, for several models side by side.

A step of a simulation costs little more for a hundred parameter sets than for ten: models to be compared are fitted
together, several dampings of each are tried at once, and each stops for itself.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.servo.profile import PROFILE, SetPoints
from leactl.gap.servo.runs import ServoRuns
from leactl.gap.servo.simulation import SHAPES, SIGNED, Parameters, simulate, table, voltages
from leactl.gap.servo.stretches import Stretches, cut

Array = npt.NDArray[np.float64]
ROUNDS = 25
OUTLIER_RAD = 0.03  # errors beyond count by their size, not their square: a slip at another instant is no other model
DAMPINGS = 10.0 ** np.arange(-2.0, 4.0)  # tried at once, relative to the last that helped
MOVED = 1e-3  # relative, by which a parameter is moved for a derivative
LIMIT_MOVED = 1e-2  # the same of a profile's: it arrives at its goal a sample earlier or later, which is not smooth
LEAST = 1e-3  # of its size, below which a positive one does not go
GAINED = 1e-3  # of the cost, below which a step is the last
SETTLED = 1e-4  # the same of a set that is told


class Fitting:
    """One model on its way to the least cost."""

    def __init__(self, start: Parameters, held: Sequence[str], runs: ServoRuns) -> None:
        self.names = [name for name in start if name not in SHAPES and name not in held]
        self.shapes = {name: value for name, value in start.items() if name not in self.names}
        self.sizes = np.array([runs.scales[name] for name in self.names])
        self.moved = np.array([LIMIT_MOVED if name in PROFILE else MOVED for name in self.names])
        self.least = np.array([-np.inf if name in SIGNED else LEAST * runs.scales[name] for name in self.names])
        if "reference_delay" in self.names:  # a stamp may be a sample early
            self.least[self.names.index("reference_delay")] = -runs.interval
        self.point = np.array([start[name] for name in self.names])
        usual = [runs.usual.get(name, (0.0, math.inf)) for name in self.names]
        self.usual, self.pull = (
            np.array([at for at, _ in usual]),
            np.array([(runs.encoder_resolution / by) ** 2 for _, by in usual]),
        )
        self.damping, self.cost, self.done = 1e-2, np.inf, False
        self.error = self.tangent = np.empty(0)

    def parameters(self, point: Array) -> Parameters:
        """A point by name."""
        return self.shapes | dict(zip(self.names, point.tolist(), strict=True))

    def moves(self) -> Array:
        """How far each parameter is moved for its derivative."""
        return np.asarray(self.moved * np.maximum(np.abs(self.point), 0.1 * self.sizes), np.float64)

    def curvature(self) -> tuple[Array, Array]:
        """Weighted normal matrix, and the slope of the cost."""
        weighted = self.tangent / np.sqrt(1.0 + (self.error / OUTLIER_RAD) ** 2)
        return weighted @ self.tangent.T + np.diag(self.pull), weighted @ self.error + self.pull * self.off(self.point)

    def off(self, point: Array) -> Array:
        """How far a point is off the model."""
        return np.asarray(point - self.usual, np.float64)

    def total(self, error: Array, point: Array) -> float:
        """Cost of a point: of its errors, and of being off the model, a count of the encoder for each prior's width.

        What runs tell next to nothing of stays where the model has it.
        """
        return cost(error) + float(self.pull @ self.off(point) ** 2)

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
        return np.asarray(np.maximum(points, self.least), np.float64)

    def take(self, points: Array, errors: Array, least_gain: float) -> None:
        """Go on to the best of the trials, or stop."""
        costs = np.array([self.total(error, point) for error, point in zip(errors, points, strict=True)])
        costs[~np.isfinite(costs)] = np.inf
        best = int(np.argmin(costs))
        gained = self.cost - float(costs[best])
        self.done = not gained > least_gain * self.cost
        if gained > 0.0:
            self.point, self.error, self.cost = points[best], errors[best], float(costs[best])
            self.damping = float(self.damping * DAMPINGS[best])


@dataclass(frozen=True, eq=False)
class FittedServo:
    """A model at its least cost."""

    parameters: Parameters
    cost: float  # sum of squares of the angle's errors, outliers by their size
    error: Array  # rad, of every measured sample
    names: tuple[str, ...]  # of what was fitted
    information: Array  # normal matrix over these, per rad^2
    scores: Array  # (runs, these): each run's own slope of the cost


def fit(
    runs: ServoRuns, starts: Sequence[Parameters], held: Sequence[str] = (), least_gain: float = GAINED
) -> list[FittedServo]:
    """Fit every parameter of each start but the shapes and those held, from where it is; all starts side by side."""
    against = MeasuredServoRuns(runs)
    fittings = [Fitting(start, held, runs) for start in starts]
    for one, errors in zip(fittings, against.errors(fittings, [f.point[None] for f in fittings]), strict=True):
        one.error, one.cost = errors[0], one.total(errors[0], one.point)
    for _ in range(ROUNDS):
        against.differentiate(fittings)
        going = [one for one in fittings if not one.done]
        if not going:
            break
        trials = [one.trials() for one in going]
        for one, points, errors in zip(going, trials, against.errors(going, trials), strict=True):
            one.take(points, errors, least_gain)
    for one in fittings:
        one.done = False
    against.differentiate(fittings)  # where each ended
    return [
        FittedServo(
            one.parameters(one.point),
            one.cost,
            one.error,
            tuple(one.names),
            one.curvature()[0],
            one.scores(against.run),
        )
        for one in fittings
    ]


def cost(error: Array) -> float:
    """Sum of squares, outliers by their size (a pseudo-Huber loss)."""
    return float(2.0 * OUTLIER_RAD**2 * np.sum(np.sqrt(1.0 + (error / OUTLIER_RAD) ** 2) - 1.0))


class MeasuredServoRuns:
    """Runs that fits are held against: the angle, and where a voltage is logged the inner error that it tells.

    A voltage over the gain is an error of the angle as the controller has it: both are counted in rad.
    """

    def __init__(self, runs: ServoRuns, whole: Stretches | None = None) -> None:
        self._runs, self._cut, self._points = runs, whole or cut(runs), SetPoints(runs)
        self._told = runs.voltage_logged if runs.voltage_logged.any() else None
        run = [np.nonzero(mask)[0] for mask in (runs.measured, self._told) if mask is not None]
        self.run = np.concatenate(run)

    def of(self, sets: Sequence[Parameters]) -> Array:
        """Errors [rad] of each set of parameters: those of the angle, then those that voltages tell."""
        runs, values = self._runs, table(sets)
        wrong = (simulate(runs, values, self._cut, self._points) - runs.angle)[:, runs.measured]
        if self._told is None:
            return wrong
        inner = (voltages(runs, values, self._points) - runs.q_axis_voltage)[:, self._told]
        return np.concatenate([wrong, inner / runs.gain[np.nonzero(self._told)[0]]], axis=1)

    def differentiate(self, fittings: Sequence[Fitting]) -> None:
        """Give each fitting that goes on the slopes of its errors."""
        going = [one for one in fittings if not one.done]
        moved = [one.point + np.diag(one.moves()) for one in going]
        for one, errors in zip(going, self.errors(going, moved), strict=True):
            one.tangent = (errors - one.error) / one.moves()[:, None]

    def errors(self, fittings: Sequence[Fitting], points: Sequence[Array]) -> list[Array]:
        """Of each fitting: errors (points, measured samples) at its points."""
        if not fittings:
            return []
        sets = [one.parameters(point) for one, own in zip(fittings, points, strict=True) for point in own]
        with np.errstate(over="ignore", invalid="ignore"):  # a trial may run away; it is not taken then
            wrong = self.of(sets)
        return np.split(wrong, np.cumsum([len(own) for own in points])[:-1])
