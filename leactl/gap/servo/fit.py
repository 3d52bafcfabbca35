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
MOST_ITERATIONS = 25  # of a fit
OUTLIER_RAD = 0.03  # rad; larger errors count by their size, not their square: a slip may come at another instant
DAMPINGS = 10.0 ** np.arange(-2.0, 4.0)  # dampings tried at once, relative to the last successful damping
DERIVATIVE_STEP = 1e-3  # relative step of a parameter for a derivative
PROFILE_DERIVATIVE_STEP = 1e-2  # relative step of a profile's parameter: its arrival changes by whole samples
LEAST_VALUE = 1e-3  # lower bound of a positive parameter, as a share of its typical size
LEAST_GAIN = 1e-3  # relative gain in cost; an iteration that gains less is the last
FINAL_LEAST_GAIN = 1e-4  # relative gain in cost from which the fit of a reported set goes on


class Fitting:
    """State of the fit of one model."""

    def __init__(self, start: Parameters, held: Sequence[str], runs: ServoRuns) -> None:
        self.names = [name for name in start if name not in SHAPE_DEFAULTS and name not in held]
        self.fixed = {name: value for name, value in start.items() if name not in self.names}
        self.sizes = np.array([runs.scales[name] for name in self.names])
        self.relative_steps = np.array(
            [PROFILE_DERIVATIVE_STEP if name in PROFILE_PARAMETERS else DERIVATIVE_STEP for name in self.names]
        )
        self.lower_bounds = np.array(
            [-np.inf if name in SIGNED_PARAMETERS else LEAST_VALUE * runs.scales[name] for name in self.names]
        )
        if "reference_delay" in self.names:  # a stamp may be a sample early
            self.lower_bounds[self.names.index("reference_delay")] = -runs.interval
        self.point = np.array([start[name] for name in self.names])
        priors = [runs.priors.get(name, (0.0, math.inf)) for name in self.names]
        self.prior_values, self.prior_weights = (
            np.array([value for value, _ in priors]),
            np.array([(runs.encoder_resolution / width) ** 2 for _, width in priors]),
        )
        self.damping, self.cost, self.is_done = 1e-2, np.inf, False
        self.error = self.derivatives = np.empty(0)

    def parameters(self, point: Array) -> Parameters:
        """Return the parameters of a point by name."""
        return self.fixed | dict(zip(self.names, point.tolist(), strict=True))

    def derivative_steps(self) -> Array:
        """Return the step of each parameter for its derivative."""
        return np.asarray(self.relative_steps * np.maximum(np.abs(self.point), 0.1 * self.sizes), np.float64)

    def curvature(self) -> tuple[Array, Array]:
        """Return the weighted normal matrix and half the gradient of the cost, at the current point."""
        weighted = self.derivatives / np.sqrt(1.0 + (self.error / OUTLIER_RAD) ** 2)
        return weighted @ self.derivatives.T + np.diag(
            self.prior_weights
        ), weighted @ self.error + self.prior_weights * self.departure(self.point)

    def departure(self, point: Array) -> Array:
        """Return the difference of a point from the values of the priors."""
        return np.asarray(point - self.prior_values, np.float64)

    def total_cost(self, error: Array, point: Array) -> float:
        """Return the cost [rad^2] of residuals and priors; a prior costs one squared encoder count at its width.

        A parameter that the runs hardly show thus stays near the model's value.
        """
        return cost(error) + float(self.prior_weights @ self.departure(point) ** 2)

    def scores(self, run_index: npt.NDArray[np.intp]) -> Array:
        """Return half the gradient of the cost by run, shape (runs, parameters)."""
        weighted = self.derivatives * self.error / np.sqrt(1.0 + (self.error / OUTLIER_RAD) ** 2)
        return np.stack([np.bincount(run_index, weights=row) for row in weighted], axis=1)

    def trial_points(self) -> Array:
        """Return the trial points of all dampings, within the parameters' lower bounds."""
        gram, slope = self.curvature()
        if not (np.isfinite(gram).all() and np.isfinite(slope).all()):
            return np.repeat(self.point[None], len(DAMPINGS), axis=0)  # no step is possible
        steps = [np.linalg.solve(gram + d * np.diag(np.diag(gram) + 1e-12), slope) for d in self.damping * DAMPINGS]
        points = self.point - np.stack(steps)
        return np.asarray(np.maximum(points, self.lower_bounds), np.float64)

    def accept_best(self, points: Array, errors: Array, least_gain: float) -> None:
        """Move to the best trial point if it lowers the cost; the fit is done if it gains `least_gain` or less."""
        costs = np.array([self.total_cost(error, point) for error, point in zip(errors, points, strict=True)])
        costs[~np.isfinite(costs)] = np.inf
        best = int(np.argmin(costs))
        gain = self.cost - float(costs[best])
        self.is_done = not gain > least_gain * self.cost
        if gain > 0.0:
            self.point, self.error, self.cost = points[best], errors[best], float(costs[best])
            self.damping = float(self.damping * DAMPINGS[best])


@dataclass(frozen=True, eq=False)
class FittedServo:
    """Result of a fit: a model at its least cost."""

    parameters: Parameters
    cost: float  # rad^2, sum of squared residuals, outliers by their size, and of the priors
    error: Array  # rad, residual of every measured sample
    names: tuple[str, ...]  # of the fitted parameters
    information: Array  # weighted normal matrix over the fitted parameters
    scores: Array  # (runs, fitted parameters), half the gradient of each run's own cost


def fit(
    runs: ServoRuns, starts: Sequence[Parameters], held: Sequence[str] = (), least_gain: float = LEAST_GAIN
) -> list[FittedServo]:
    """Fit all parameters of each start except shapes and those in `held`; all starts are fitted side by side."""
    measured_runs = MeasuredServoRuns(runs)
    fittings = [Fitting(start, held, runs) for start in starts]
    points = [fitting.point[None] for fitting in fittings]
    for fitting, errors in zip(fittings, measured_runs.errors(fittings, points), strict=True):
        fitting.error, fitting.cost = errors[0], fitting.total_cost(errors[0], fitting.point)
    for _ in range(MOST_ITERATIONS):
        measured_runs.differentiate(fittings)
        unfinished = [fitting for fitting in fittings if not fitting.is_done]
        if not unfinished:
            break
        trials = [fitting.trial_points() for fitting in unfinished]
        for fitting, trial_points, errors in zip(
            unfinished, trials, measured_runs.errors(unfinished, trials), strict=True
        ):
            fitting.accept_best(trial_points, errors, least_gain)
    for fitting in fittings:
        fitting.is_done = False
    measured_runs.differentiate(fittings)  # at the final points
    return [
        FittedServo(
            fitting.parameters(fitting.point),
            fitting.cost,
            fitting.error,
            tuple(fitting.names),
            fitting.curvature()[0],
            fitting.scores(measured_runs.run_of_residual),
        )
        for fitting in fittings
    ]


def cost(error: Array) -> float:
    """Return the pseudo-Huber loss [rad^2]: the sum of squares, in which outliers count by their size."""
    return float(2.0 * OUTLIER_RAD**2 * np.sum(np.sqrt(1.0 + (error / OUTLIER_RAD) ** 2) - 1.0))


class MeasuredServoRuns:
    """Measured runs that give residuals of angles and, where logged, of the controller's voltages.

    A voltage over the gain is the controller's error of the angle, so all residuals are in rad.
    """

    def __init__(self, runs: ServoRuns, stretches: Stretches | None = None) -> None:
        self._runs, self._stretches, self._points = runs, stretches or cut_runs(runs), SetPoints(runs)
        self._voltage_logged = runs.voltage_logged if runs.voltage_logged.any() else None
        run_indices = [np.nonzero(mask)[0] for mask in (runs.measured, self._voltage_logged) if mask is not None]
        self.run_of_residual = np.concatenate(run_indices)

    def residuals(self, sets: Sequence[Parameters]) -> Array:
        """Return residuals [rad] of parameter sets, (sets, residuals): angles first, then voltages over the gain."""
        runs, values = self._runs, table(sets)
        angle_errors = (simulate(runs, values, self._stretches, self._points) - runs.angle)[:, runs.measured]
        if self._voltage_logged is None:
            return angle_errors
        voltage_errors = (voltages(runs, values, self._points) - runs.q_axis_voltage)[:, self._voltage_logged]
        return np.concatenate([angle_errors, voltage_errors / runs.gain[np.nonzero(self._voltage_logged)[0]]], axis=1)

    def differentiate(self, fittings: Sequence[Fitting]) -> None:
        """Set the derivatives of the errors of each fitting that is not done."""
        unfinished = [fitting for fitting in fittings if not fitting.is_done]
        stepped_points = [fitting.point + np.diag(fitting.derivative_steps()) for fitting in unfinished]
        for fitting, errors in zip(unfinished, self.errors(unfinished, stepped_points), strict=True):
            fitting.derivatives = (errors - fitting.error) / fitting.derivative_steps()[:, None]

    def errors(self, fittings: Sequence[Fitting], points: Sequence[Array]) -> list[Array]:
        """Return residuals (points, measured samples) of each fitting at its points."""
        if not fittings:
            return []
        sets = [
            fitting.parameters(point)
            for fitting, fitting_points in zip(fittings, points, strict=True)
            for point in fitting_points
        ]
        with np.errstate(over="ignore", invalid="ignore"):  # a trial may run away; it is not accepted then
            residuals = self.residuals(sets)
        return np.split(residuals, np.cumsum([len(fitting_points) for fitting_points in points])[:-1])
