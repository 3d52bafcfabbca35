"""Drag of a turning rotor over speed: torque = f sgn(w) + b w + c w |w|, from steady levels of velocity.

Losses with the same dependence on speed cannot be distinguished: f contains Coulomb friction and hysteresis of the
iron, b viscous friction and eddy currents, and c the drag of air and splashed grease. A velocity loop holds the levels,
so that the scatter of the drag is not in the velocity.
"""

from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import Estimate, Noted, tally
from leactl.analysis.signals.levels import HoldMeans
from leactl.analysis.statistics.linefit import LineFit, fit_lines
from leactl.analysis.statistics.regression import Array, LeastSquaresFit
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Run

VELOCITY = "velocity"
FEWEST_LEVELS = 4  # distinct speeds: one more than f, b and c need
MOST_SPEED_ERROR = 0.05  # of the setpoint; a level whose velocity differs by more was not reached
LEAST_OPPOSITE_VELOCITY = 0.5  # of the setpoint; a larger velocity of opposite sign has the wrong sign
MOST_QUARTER_SPREAD = 0.02  # of the setpoint; a hold whose quarters differ by more was not steady
UNITS = {"viscous_damping": "N*m*s/rad", "coulomb_friction": "N*m", "quadratic_drag": "N*m*s^2/rad^2"}


def holds_at_setpoint(runs: Sequence[Run], levels: HoldMeans, error_prefix: str) -> Noted[HoldMeans]:
    """Return the holds in which the shaft turned steadily at its setpoint; notes name the other holds and the reasons.

    Raises
    ------
    NotIdentifiable : these holds have fewer than `FEWEST_LEVELS` distinct speeds.
    """
    velocity, setpoint, quarters = levels.means[VELOCITY], levels.setpoint, levels.quarter_means[VELOCITY]
    is_unsteady = np.nanmax(quarters, axis=1) - np.nanmin(quarters, axis=1) > MOST_QUARTER_SPREAD * np.abs(setpoint)
    is_opposite = velocity * setpoint < 0.0
    reasons = {
        "the shaft was to stand": setpoint == 0.0,
        "the velocity has the opposite sign of its setpoint": is_opposite
        & (np.abs(velocity) > LEAST_OPPOSITE_VELOCITY * np.abs(setpoint)),
        "the velocity was not reached": np.abs(velocity - setpoint) > MOST_SPEED_ERROR * np.abs(setpoint),
        "the velocity was not steady": is_unsteady,
    }
    usable = np.ones(len(levels), np.bool_)
    notes = []
    for reason, applies in reasons.items():
        for number in np.unique(levels.run_index[applies & usable]):
            indices = np.flatnonzero(applies & usable & (levels.run_index == number))
            notes += tally({reason: [str(levels.holds[index]) for index in indices]}, f"{runs[number].path}")
        usable &= ~applies
    speed_count = len(np.unique(np.round(np.abs(setpoint[usable]), 9)))
    if speed_count < FEWEST_LEVELS:
        notes_text = f" ({'; '.join(notes)})" if notes else ""
        raise NotIdentifiable(
            f"{error_prefix}: found {speed_count} speeds at which the shaft turned steadily{notes_text}; "
            f"{FEWEST_LEVELS} or more are needed"
        )
    return Noted(levels.where(usable), tuple(notes))


def fit_drag(levels: HoldMeans, torque: Array, error_prefix: str) -> LineFit:
    """Fit the torque that keeps the shaft turning [N*m] over velocity, with a zero error for each run.

    If the shaft turned in one direction only, the Coulomb friction contains that error.
    """
    velocity = levels.means[VELOCITY]
    columns = {"viscous_damping": velocity, "quadratic_drag": velocity * np.abs(velocity)}
    if turned_both_ways(levels):
        columns["coulomb_friction"] = np.sign(velocity)
    return fit_lines(columns, torque, levels, error_prefix)


def turned_both_ways(levels: HoldMeans) -> bool:
    """Return whether the shaft turned in both directions."""
    return len(np.unique(np.sign(levels.means[VELOCITY]))) == 2


def coefficients(line: LineFit, relative_std: float = 0.0) -> list[Estimate]:
    """Estimate viscous damping, Coulomb friction and quadratic drag.

    `relative_std` is the relative standard uncertainty of a factor on the torque.
    """
    estimates = [line.estimate("viscous_damping", "viscous_damping", UNITS["viscous_damping"], relative_std)]
    if "coulomb_friction" in line.slopes:
        estimates.append(line.estimate("coulomb_friction", "coulomb_friction", UNITS["coulomb_friction"], relative_std))
    else:
        weights = line.mean_intercept * float(np.sign(line.levels.means[VELOCITY][0]))
        estimates.append(line.fit.estimate("coulomb_friction", UNITS["coulomb_friction"], weights, relative_std))
    return [*estimates, line.estimate("quadratic_drag", "quadratic_drag", UNITS["quadratic_drag"], relative_std)]


def weights_at(line: LineFit, speed: float) -> Array:
    """Return the weights of the coefficients in the drag torque at a speed [rad/s], shape (coefficients,).

    The zero error of the torque is left out, unless the shaft turned in one direction only.
    """
    terms = {"viscous_damping": speed, "quadratic_drag": speed * speed, "coulomb_friction": 1.0}
    weights = np.zeros(len(line.fit.coefficients))
    weights[: len(line.slopes)] = [terms[name] for name in line.slopes]
    if "coulomb_friction" not in line.slopes:
        weights += line.mean_intercept * float(np.sign(line.levels.means[VELOCITY][0]))
    return weights


def drag_at(fit: LeastSquaresFit, line: LineFit, speeds: Array) -> Array:
    """Return the drag torque [N*m] of a fit at speeds [rad/s], shape (speeds,); `line` names its coefficients."""
    return np.array([fit.combination(weights_at(line, float(speed)))[0] for speed in speeds])
