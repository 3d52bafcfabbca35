"""Viscous damping and Coulomb friction of a free rotor: Kt i = b w + f sgn(w) at steady velocity.

Paper, section "Friction and Damping". The current is set and the velocity follows, with all the scatter of the friction
in it, so the setpoint is the instrument of the velocity (linefit.py). Both b and f are in proportion to the torque
constant, which comes from the model that the run carries or from the caller, and to the drive's calibration of current.
In a torque constant measured with the same drive, the error of that calibration is inverse and cancels: then the caller
gives a smaller `current_gain_std`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Noted, Plot, Result, Series, tally
from leactl.analysis.quality.calibration_uncertainty import calibration_notes, gain_std
from leactl.analysis.quality.sign_checks import SIGN_SWAPPED
from leactl.analysis.quality.usable_readings import usable_channel
from leactl.analysis.quality.wrong_units import unit_notes
from leactl.analysis.run_model import torque_constant_of_model
from leactl.analysis.signals.levels import HoldMeans, gather_means, require_levels
from leactl.analysis.statistics.linefit import LineFit, fit_lines, fit_notes, paths_of, setup_notes
from leactl.analysis.statistics.regression import Array
from leactl.errors import InputError, NotIdentifiable
from leactl.runfile.read.reader import Run

RESULTS = {
    "viscous_damping": "N*m*s/rad",
    "viscous_damping_forward": "N*m*s/rad",
    "viscous_damping_backward": "N*m*s/rad",
    "coulomb_friction": "N*m",
    "coulomb_friction_forward": "N*m",
    "coulomb_friction_backward": "N*m",
    "offset": "N*m",
    "r_squared": "1",
    "r_squared_forward": "1",
    "r_squared_backward": "1",
}

CURRENT, VELOCITY = "q_axis_current", "velocity"
DIRECTIONS = {"forward": 1.0, "backward": -1.0}
TURNING_STANDARD_ERRORS = 4.0  # of a mean velocity; a mean of fewer may be that of a rotor at rest
SLOWEST_TURNING_SHARE = 0.02  # of the fastest level; a slower rotor does not count as turning
MOST_QUARTER_SPREAD = 0.05  # of the mean; a hold whose quarters differ by more was not steady


@dataclass(frozen=True, eq=False)
class TorqueConstants:
    """The torque constant of each run [N*m/A], shape (runs,), its uncertainty and its source."""

    values: Array
    relative_std: float  # includes that of the current's calibration
    note: str


def analyze(
    runs: Sequence[Run],
    *,
    torque_constant: float | None = None,
    torque_constant_std: float | None = None,
    current_gain_std: float | None = None,
) -> Result:
    """Fit the torque of the current over steady velocity, both directions together and each alone.

    `viscous_damping` [N*m*s/rad], `coulomb_friction` [N*m], `r_squared`, and the same for each direction alone as
    `_forward`, `_backward`; with both directions also `offset` [N*m], the mean over the runs, from a zero error of the
    current.

    Parameters
    ----------
    runs : of one actuator under one condition, free, whose steps `hold` its current at two levels or more.
    torque_constant : [N*m/A], in place of the one in the runs' model.
    torque_constant_std : [N*m/A], its standard uncertainty, which then is part of that of b and f.
    current_gain_std : relative standard uncertainty of the current's calibration, less what cancels with the torque
        constant; by default that of the channel.

    Raises
    ------
    MissingChannel : a run has no velocity or no q-axis current of the test actuator.
    NotIdentifiable : no torque constant, fewer than two levels at which the rotor turned, or too few points.
    InputError : a torque constant that is no positive number, an uncertainty below zero, or current and velocity of
        opposite senses.
    """
    error_prefix = f"{paths_of(runs)}: friction"
    constants = torque_constants(runs, torque_constant, torque_constant_std, current_gain_std)
    notes = setup_notes(runs, ("free",), "friction of whatever else is on the shaft is counted in")
    hold_means = gather_means(runs, (CURRENT, VELOCITY), usable_channel)
    steady_levels = steady_holds(runs, hold_means.value, error_prefix)
    levels = steady_levels.value
    notes += [*hold_means.notes, *steady_levels.notes]
    sign = np.sign(levels.means[VELOCITY])
    torque = constants.values[levels.run_index] * levels.means[CURRENT]
    unit = "N" if levels.units[VELOCITY] == "m/s" else "N*m"
    notes.append(constants.note)

    direction_lines = {
        name: line_of_direction(levels, torque, direction, error_prefix) for name, direction in DIRECTIONS.items()
    }
    if len(np.unique(sign)) == 2:
        line = line_of_both_directions(levels, torque, sign, error_prefix)
        results = line_results(line, "", unit, constants.relative_std)
        for name, direction_line in direction_lines.items():
            if isinstance(direction_line, NotIdentifiable):
                notes.append(
                    f"{name} levels alone give no line: {str(direction_line).removeprefix(error_prefix + ': ')}"
                )
            else:
                results += line_results(direction_line, f"_{name}", unit, constants.relative_std, DIRECTIONS[name])
    else:
        direction = float(sign[0])
        name = next(name for name, value in DIRECTIONS.items() if value == direction)
        direction_line = direction_lines[name]
        if isinstance(direction_line, NotIdentifiable):
            raise direction_line
        line = direction_line
        results = line_results(line, "", unit, constants.relative_std, direction)
        notes.append(f"the rotor turned {name} only: a zero error of the current is part of coulomb_friction")
    damping = line.slope("viscous_damping")
    noise = np.hypot(
        constants.values[levels.run_index] * levels.standard_errors[CURRENT], damping * levels.standard_errors[VELOCITY]
    )
    notes += fit_notes(line, noise, unit)
    paths = tuple(str(run.path) for run in runs)
    plot = plot_of(levels, torque, line, sign, unit)
    names = ("viscous_damping", "coulomb_friction", "offset", "r_squared")
    overall_results = [estimate for estimate in results if not estimate.name.endswith(tuple(DIRECTIONS))]
    notes[:0] = unit_notes(runs, overall_results, [CURRENT], [VELOCITY], torque_constant)
    results.sort(key=lambda estimate: next(k for k, name in enumerate(names) if estimate.name.startswith(name)))
    return Result("friction", paths, tuple(results), tuple(notes), (plot,))


def refuse_torque_constant(value: float | None, std: float | None) -> None:
    """Raise InputError if a torque constant [N*m/A] is not above zero, or its standard uncertainty is below zero."""
    if value is not None and not (math.isfinite(value) and value > 0.0):
        raise InputError(f"torque constant {value:g}: a positive number in N*m/A was expected")
    if std is not None and not (math.isfinite(std) and std >= 0.0):
        raise InputError(f"standard uncertainty of the torque constant {std:g}: zero or more in N*m/A was expected")


def torque_constants(
    runs: Sequence[Run], given_constant: float | None, std: float | None, current_gain_std: float | None
) -> TorqueConstants:
    """Return the torque constant of each run: the given constant, or that of the model in the run.

    The relative uncertainty includes that of the current's calibration, which scales the same torque.

    Raises
    ------
    NotIdentifiable : no constant is given and a run has none.
    InputError : see `refuse_torque_constant` and `gain_std`.
    """
    refuse_torque_constant(given_constant, std)
    values = np.array([given_constant if given_constant is not None else torque_constant_of_model(run) for run in runs])
    constants_text = ", ".join(f"{value:g}" for value in np.unique(values))
    source = "as given" if given_constant is not None else "from the model in the run"
    relative_std, gain = (std or 0.0) / float(values.mean()), gain_std(runs, CURRENT, current_gain_std)
    uncertainty_text = (
        f"its standard uncertainty of {relative_std:.2%} is in theirs" if std else "its uncertainty is not in theirs"
    )
    note = (
        f"torque constant {constants_text} N*m/A, {source}; viscous damping and Coulomb friction scale with it,"
        f" {uncertainty_text}"
    )
    if gain:
        note += "".join(f"; {text}" for text in calibration_notes({"current": gain}, "them"))
    return TorqueConstants(values, math.hypot(relative_std, gain), note)


def steady_holds(runs: Sequence[Run], levels: HoldMeans, error_prefix: str) -> Noted[HoldMeans]:
    """Return the holds in which the rotor turned steadily with its current; notes name the other holds and the reasons.

    The means of four quarters of each settled part are compared, not of two halves: a rotor that stops late moves the
    last quarter more than the second half.

    Raises
    ------
    NotIdentifiable : fewer than two distinct levels are left.
    InputError : the rotor turned against its current throughout.
    """
    velocity, current = levels.means[VELOCITY], levels.means[CURRENT]
    is_still = np.abs(velocity) < np.maximum(
        TURNING_STANDARD_ERRORS * levels.standard_errors[VELOCITY],
        SLOWEST_TURNING_SHARE * float(np.max(np.abs(velocity))),
    )
    is_still |= velocity == 0.0
    quarters = levels.quarter_means[VELOCITY]
    is_unsteady = np.nanmax(quarters, axis=1) - np.nanmin(quarters, axis=1) > MOST_QUARTER_SPREAD * np.abs(velocity)
    is_turning = ~is_still
    if is_turning.any() and (velocity * current < 0.0)[is_turning].all():
        raise InputError(
            f"{error_prefix}: the rotor turned against its current in all {is_turning.sum()} holds in which it turned;"
            f" {SIGN_SWAPPED}"
        )
    reasons = {
        "the rotor did not turn": is_still,
        "the velocity was not steady": is_unsteady,
        "the rotor turned against its current": velocity * current < 0.0,
    }
    usable = np.ones(len(levels), np.bool_)
    left_out: dict[tuple[int, str], list[str]] = {}
    for reason, applies in reasons.items():
        for index in np.flatnonzero(applies & usable):
            left_out.setdefault((int(levels.run_index[index]), reason), []).append(str(levels.holds[index]))
        usable &= ~applies
    notes = [
        note
        for (number, reason), holds in sorted(left_out.items())
        for note in tally({reason: holds}, f"{runs[number].path}")
    ]
    level_count = len(np.unique(np.round(levels.setpoint[usable], 9)))
    if level_count < 2:
        reasons_text = "; ".join(f"{len(holds)} holds: {reason}" for (_, reason), holds in left_out.items())
        raise NotIdentifiable(
            f"{error_prefix}: found {level_count} levels of current at which the rotor turned steadily"
            f"{f' ({reasons_text})' if reasons_text else ''}; two or more are needed"
        )
    return Noted(levels.where(usable), tuple(notes))


def regressors(levels: HoldMeans, sign: Array) -> dict[str, Array]:
    """Return the fit's columns: the velocity, and its sign if the levels have both signs; shape (holds,) each."""
    columns = {"viscous_damping": levels.means[VELOCITY]}
    return columns | {"coulomb_friction": sign} if len(np.unique(sign)) == 2 else columns


def line_of_both_directions(levels: HoldMeans, torque: Array, sign: Array, error_prefix: str) -> LineFit:
    """Fit both directions with one slope, one friction and an offset for each run.

    Raises
    ------
    NotIdentifiable : neither direction has enough levels, or the holds do not determine the fit.
    """
    faults = []
    for direction in DIRECTIONS.values():
        one_way = levels.where(sign == direction)
        try:
            require_levels(error_prefix, "velocity", VELOCITY, one_way)
        except NotIdentifiable as fault:
            faults.append(fault)
    if len(faults) == len(DIRECTIONS):
        raise faults[0]
    return fit_lines(regressors(levels, sign), torque, levels, error_prefix)


def line_of_direction(
    levels: HoldMeans, torque: Array, direction: float, error_prefix: str
) -> LineFit | NotIdentifiable:
    """Return the fit of one direction alone, or the error that says why it is not possible."""
    in_direction = np.sign(levels.means[VELOCITY]) == direction
    if not in_direction.any():
        return NotIdentifiable(f"{error_prefix}: found no level at which the rotor turned that way")
    one_way = levels.where(in_direction)
    velocity = one_way.means[VELOCITY]
    try:
        require_levels(error_prefix, "velocity", VELOCITY, one_way)
        return fit_lines({"viscous_damping": velocity}, torque[in_direction], one_way, error_prefix)
    except NotIdentifiable as fault:
        return fault


def line_results(
    line: LineFit, suffix: str, unit: str, relative_std: float, direction: float | None = None
) -> list[Estimate]:
    """Return the estimates of one fit; if `direction` is given, the intercept is the Coulomb friction.

    `unit` is that of the torque; `relative_std` is the relative standard uncertainty of a factor on it.
    """
    per_velocity = "N*s/m" if unit == "N" else "N*m*s/rad"
    fit = line.fit
    estimates = [line.estimate("viscous_damping", f"viscous_damping{suffix}", per_velocity, relative_std)]
    if direction is not None:
        intercept = direction * line.mean_intercept
        estimates.append(fit.estimate(f"coulomb_friction{suffix}", unit, intercept, relative_std))
    else:
        estimates.append(line.estimate("coulomb_friction", "coulomb_friction", unit, relative_std))
        estimates.append(fit.estimate("offset", unit, line.mean_intercept, relative_std))
    return [*estimates, Estimate(f"r_squared{suffix}", fit.r_squared, NAN, NAN, NAN, "1")]


def points_by_direction(velocity: Array, values: Array) -> tuple[Series, ...]:
    """Return values over speed as one series for each direction that occurs; both arguments have shape (holds,)."""
    series = []
    for label, direction in DIRECTIONS.items():
        in_direction = np.sign(velocity) == direction
        if in_direction.any():
            speed = np.abs(velocity[in_direction])
            series.append(Series(label, tuple(speed.tolist()), tuple(values[in_direction].tolist())))
    return tuple(series)


def plot_of(levels: HoldMeans, torque: Array, line: LineFit, sign: Array, unit: str) -> Plot:
    """Return the plot of the current's torque over speed, both along the motion, by direction."""
    velocity = levels.means[VELOCITY]
    intercept = float(line.fit.coefficients @ line.mean_intercept)
    coulomb = line.slope("coulomb_friction") if "coulomb_friction" in line.slopes else 0.0
    points, lines = [], []
    for label, direction in DIRECTIONS.items():
        in_direction = sign == direction
        if in_direction.any():
            speed, torque_along_motion = direction * velocity[in_direction], direction * torque[in_direction]
            points.append(Series(label, tuple(speed.tolist()), tuple(torque_along_motion.tolist())))
            end_speeds = np.array([speed.min(), speed.max()])
            fitted = line.slope("viscous_damping") * end_speeds + coulomb + direction * intercept
            lines.append(Series(label, tuple(end_speeds.tolist()), tuple(fitted.tolist())))
    label = "rad/s" if unit == "N*m" else "m/s"
    return Plot(f"speed [{label}]", f"torque of the current [{unit}]", tuple(points), tuple(lines))
