"""Fit parameters by free simulation: Levenberg-Marquardt steps for several models side by side.

A step of a simulation costs little more for a hundred parameter sets than for ten: models to be compared are fitted
together, several dampings of each are tried at once, and each stops for itself.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.servo.profile import PROFILE_PARAMETERS, SetPoints
from leactl.gap.servo.runs import ServoRuns
from leactl.gap.servo.simulation import SHAPE_DEFAULTS, SIGNED_PARAMETERS, Parameters, simulate, table, voltages
from leactl.gap.servo.stretches import Stretches, cut_runs

Array = npt.NDArray[np.float64]
MOST_ITERATIONS = 25
OUTLIER_RAD = 0.03  # rad; larger errors count by their size, not their square: a slip may come at another instant
DAMPINGS = 10.0 ** np.arange(-2.0, 4.0)  # tried at once, relative to the last successful one
DERIVATIVE_STEP = 1e-3  # relative step of a parameter for a derivative
PROFILE_DERIVATIVE_STEP = 1e-2  # the same for a profile's parameter: the sample of arrival changes in whole steps
LEAST_VALUE = 1e-3  # lower bound of a positive parameter, as a share of its typical size
LEAST_GAIN = 1e-3  # relative gain in cost; an iteration that gains less is the last
FINAL_LEAST_GAIN = 1e-4  # the same for a set that is reported


class Fitting:
    """One model during its fit."""

    def __init__(self, start: Parameters, held: Sequence[str], runs: ServoRuns) -> None:
        self.names = [name for name in start if name not in SHAPE_DEFAULTS and name not in held]
        self.shapes = {name: value for name, value in start.items() if name not in self.names}
        self.sizes = np.array([runs.scales[name] for name in self.names])
        self.moved = np.array(
            [PROFILE_DERIVATIVE_STEP if name in PROFILE_PARAMETERS else DERIVATIVE_STEP for name in self.names]
        )
        self.least = np.array(
            [-np.inf if name in SIGNED_PARAMETERS else LEAST_VALUE * runs.scales[name] for name in self.names]
        )
        if "reference_delay" in self.names:  # a stamp may be a sample early
            self.least[self.names.index("reference_delay")] = -runs.interval
        self.point = np.array([start[name] for name in self.names])
        usual = [runs.usual.get(name, (0.0, math.inf)) for name in self.names]
        self.usual, self.pull = (
            np.array([usual_value for usual_value, _ in usual]),
            np.array([(runs.encoder_resolution / width) ** 2 for _, width in usual]),
        )
        self.damping, self.cost, self.done = 1e-2, np.inf, False
        self.error = self.tangent = np.empty(0)

    def parameters(self, point: Array) -> Parameters:
        """Return the parameters of a point by name."""
        return self.shapes | dict(zip(self.names, point.tolist(), strict=True))

    def moves(self) -> Array:
        """Return the step of each parameter for its derivative."""
        return np.asarray(self.moved * np.maximum(np.abs(self.point), 0.1 * self.sizes), np.float64)

    def curvature(self) -> tuple[Array, Array]:
        """Return the weighted normal matrix and the slope of the cost."""
        weighted = self.tangent / np.sqrt(1.0 + (self.error / OUTLIER_RAD) ** 2)
        return weighted @ self.tangent.T + np.diag(self.pull), weighted @ self.error + self.pull * self.off(self.point)

    def off(self, point: Array) -> Array:
        """Return the difference of a point from the model."""
        return np.asarray(point - self.usual, np.float64)

    def total(self, error: Array, point: Array) -> float:
        """Return the cost of residuals plus that of the priors, one squared encoder count at one prior width.

        A parameter that the runs hardly show thus stays near the model's value.
        """
        return cost(error) + float(self.pull @ self.off(point) ** 2)

    def scores(self, run: npt.NDArray[np.intp]) -> Array:
        """Return the slope of the cost by run."""
        weighted = self.tangent * self.error / np.sqrt(1.0 + (self.error / OUTLIER_RAD) ** 2)
        return np.stack([np.bincount(run, weights=row) for row in weighted], axis=1)

    def trials(self) -> Array:
        """Return the trial points of all dampings, within the parameters' lower bounds."""
        gram, slope = self.curvature()
        if not (np.isfinite(gram).all() and np.isfinite(slope).all()):
            return np.repeat(self.point[None], len(DAMPINGS), axis=0)  # no step is possible
        steps = [np.linalg.solve(gram + d * np.diag(np.diag(gram) + 1e-12), slope) for d in self.damping * DAMPINGS]
        points = self.point - np.stack(steps)
        return np.asarray(np.maximum(points, self.least), np.float64)

    def take(self, points: Array, errors: Array, least_gain: float) -> None:
        """Move to the best of the trials, or stop."""
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
    """Result of a fit: a model at its least cost."""

    parameters: Parameters
    cost: float  # sum of squares of the angle's errors, outliers by their size
    error: Array  # rad, of every measured sample
    names: tuple[str, ...]  # of the fitted parameters
    information: Array  # normal matrix over these, per rad^2
    scores: Array  # (runs, these): each run's own slope of the cost


def fit(
    runs: ServoRuns, starts: Sequence[Parameters], held: Sequence[str] = (), least_gain: float = LEAST_GAIN
) -> list[FittedServo]:
    """Fit all parameters of each start except shapes and those in `held`; all starts are fitted side by side."""
    against = MeasuredServoRuns(runs)
    fittings = [Fitting(start, held, runs) for start in starts]
    points = [fitting.point[None] for fitting in fittings]
    for fitting, errors in zip(fittings, against.errors(fittings, points), strict=True):
        fitting.error, fitting.cost = errors[0], fitting.total(errors[0], fitting.point)
    for _ in range(MOST_ITERATIONS):
        against.differentiate(fittings)
        going = [fitting for fitting in fittings if not fitting.done]
        if not going:
            break
        trials = [fitting.trials() for fitting in going]
        for fitting, trial_points, errors in zip(going, trials, against.errors(going, trials), strict=True):
            fitting.take(trial_points, errors, least_gain)
    for fitting in fittings:
        fitting.done = False
    against.differentiate(fittings)  # at the final points
    return [
        FittedServo(
            fitting.parameters(fitting.point),
            fitting.cost,
            fitting.error,
            tuple(fitting.names),
            fitting.curvature()[0],
            fitting.scores(against.run),
        )
        for fitting in fittings
    ]


def cost(error: Array) -> float:
    """Return the pseudo-Huber loss: the sum of squares, outliers by their size."""
    return float(2.0 * OUTLIER_RAD**2 * np.sum(np.sqrt(1.0 + (error / OUTLIER_RAD) ** 2) - 1.0))


class MeasuredServoRuns:
    """Measured runs that give residuals of angles and, where logged, of the controller's voltages.

    A voltage over the gain is the controller's error of the angle, so all residuals are in rad.
    """

    def __init__(self, runs: ServoRuns, whole: Stretches | None = None) -> None:
        self._runs, self._stretches, self._points = runs, whole or cut_runs(runs), SetPoints(runs)
        self._voltage_logged = runs.voltage_logged if runs.voltage_logged.any() else None
        run = [np.nonzero(mask)[0] for mask in (runs.measured, self._voltage_logged) if mask is not None]
        self.run = np.concatenate(run)

    def of(self, sets: Sequence[Parameters]) -> Array:
        """Return residuals [rad] (sets, measured samples): angles first, then voltages over the gain."""
        runs, values = self._runs, table(sets)
        angle_errors = (simulate(runs, values, self._stretches, self._points) - runs.angle)[:, runs.measured]
        if self._voltage_logged is None:
            return angle_errors
        voltage_errors = (voltages(runs, values, self._points) - runs.q_axis_voltage)[:, self._voltage_logged]
        return np.concatenate([angle_errors, voltage_errors / runs.gain[np.nonzero(self._voltage_logged)[0]]], axis=1)

    def differentiate(self, fittings: Sequence[Fitting]) -> None:
        """Set the derivatives of the errors of each fitting that is not done."""
        going = [fitting for fitting in fittings if not fitting.done]
        moved = [fitting.point + np.diag(fitting.moves()) for fitting in going]
        for fitting, errors in zip(going, self.errors(going, moved), strict=True):
            fitting.tangent = (errors - fitting.error) / fitting.moves()[:, None]

    def errors(self, fittings: Sequence[Fitting], points: Sequence[Array]) -> list[Array]:
        """Return residuals (points, measured samples) of each fitting at its points."""
        if not fittings:
            return []
        sets = [
            fitting.parameters(point)
            for fitting, of_fitting in zip(fittings, points, strict=True)
            for point in of_fitting
        ]
        with np.errstate(over="ignore", invalid="ignore"):  # a trial may run away; it is not taken then
            wrong = self.of(sets)
        return np.split(wrong, np.cumsum([len(of_fitting) for of_fitting in points])[:-1])
