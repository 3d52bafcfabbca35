"""Torque constant: slope of shaft torque over q-axis current while the load actuator holds position.

Paper, section "Torque Constant". A rotor at rest sticks: friction carries up to the friction torque past the sensor. If
each level is reached from one side throughout, the torque s that it carries is the same for all rising levels and
opposite for all falling levels, so that torque = Kt i + c + s d with d = 1 rising and d = -1 falling. A line through
the origin would count s as torque of the current: on the LEA, that is 2 to 3 % of the torque constant.
"""

import math
from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Noted, Plot, Result, Series, listed
from leactl.analysis.quality.calibration_uncertainty import calibration_notes, gain_std
from leactl.analysis.quality.current_convention import reason_for_torque_constant
from leactl.analysis.quality.sign_checks import refuse_below_zero
from leactl.analysis.quality.usable_readings import usable_channel
from leactl.analysis.quality.wrong_units import unit_notes
from leactl.analysis.run_model import torque_constant_of_model
from leactl.analysis.signals.levels import HoldMeans, gather_means, require_levels
from leactl.analysis.statistics.linefit import LineFit, fit_lines, fit_notes, paths_of, setup_notes
from leactl.analysis.statistics.regression import Array
from leactl.errors import InputError, NotIdentifiable
from leactl.runfile.read.reader import Run

RESULTS = {
    "torque_constant": "N*m/A",
    "torque_constant_rising": "N*m/A",
    "torque_constant_falling": "N*m/A",
    "sticking_torque": "N*m",
    "offset": "N*m",
    "r_squared": "1",
}

CURRENT, TORQUE = "q_axis_current", "torque"
SIDES = {"rising": 1, "falling": -1}


def analyze(
    runs: Sequence[Run], *, torque_gain_std: float | None = None, current_gain_std: float | None = None
) -> Result:
    """Fit shaft torque over q-axis current; the sticking torque separates levels reached from below and from above.

    `torque_constant` [N*m/A], `sticking_torque` [N*m] (half the difference of rising and falling levels), `offset`
    [N*m] (mean over the runs), `r_squared`, and `torque_constant_rising` and `_falling`, each from a line of its own.

    Parameters
    ----------
    runs : of one actuator under one condition, whose steps `hold` its current at two levels or more.
    torque_gain_std, current_gain_std : relative standard uncertainties of the readings' calibration; by default
        those of the channels.

    Raises
    ------
    MissingChannel : a run has no torque or no q-axis current of the test actuator.
    NotIdentifiable : fewer than two distinct levels within the sensor's range, or too few points.
    InputError : an uncertainty below zero, or torque and current of opposite senses.
    """
    error_prefix = f"{paths_of(runs)}: torque constant"
    notes = setup_notes(runs, ("coupled", "locked"), "a shaft that turns takes torque past the sensor")
    torque_std = gain_std(runs, TORQUE, torque_gain_std)
    current_std = gain_std(runs, CURRENT, current_gain_std)
    constant_std = math.hypot(torque_std, current_std)
    usable_levels = torque_levels(runs, error_prefix)
    levels = usable_levels.value
    notes += usable_levels.notes
    current, torque = levels.means[CURRENT], levels.means[TORQUE]

    columns = {"torque_constant": current}
    both_sides = len(np.unique(levels.direction)) == 2
    if both_sides:
        columns["sticking_torque"] = levels.direction.astype(np.float64)
    else:
        notes.append(
            "all levels were reached from one side, or no side is stated: sticking friction is part of the offset"
        )
    line = fit_lines(columns, torque, levels, error_prefix)
    expected_scatter = np.hypot(
        levels.standard_errors[TORQUE], line.slope("torque_constant") * levels.standard_errors[CURRENT]
    )
    unit = levels.units[TORQUE]
    notes += fit_notes(line, expected_scatter, unit)
    notes += [f"{run.path}: {note}" for run in runs for note in convention_notes(run, line.slope("torque_constant"))]
    notes += calibration_notes({"torque": torque_std, "current": current_std}, "the torque constants")

    results = [line.estimate("torque_constant", "torque_constant", f"{unit}/A", constant_std)]
    refuse_below_zero(results[0], error_prefix, "torque and current")
    if both_sides:
        side_slopes = slopes_by_side(levels, error_prefix, constant_std)
        results += side_slopes.value
        notes += side_slopes.notes
        results.append(magnitude(line.estimate("sticking_torque", "sticking_torque", unit, torque_std)))
    results.append(line.fit.estimate("offset", unit, line.mean_intercept, torque_std))
    results.append(Estimate("r_squared", line.fit.r_squared, NAN, NAN, NAN, "1"))
    notes[:0] = unit_notes(runs, results[:1], [TORQUE], [CURRENT])
    paths = tuple(str(run.path) for run in runs)
    return Result("torque-constant", paths, tuple(results), tuple(notes), (plot_of(levels, line),))


def convention_notes(run: Run, torque_constant: float) -> list[str]:
    """Return a note if torque constant and model differ by the factor of a wrong convention of current."""
    try:
        ratio = torque_constant / torque_constant_of_model(run)
    except InputError:  # a foreign run may carry no model, or none that can be read
        return []
    reason = reason_for_torque_constant(ratio)
    return [f"the torque constant is {ratio:.3f} times that of the model in the run: {reason}"] if reason else []


def torque_levels(runs: Sequence[Run], error_prefix: str) -> Noted[HoldMeans]:
    """Return the mean current and torque of the usable holds; notes name the other holds.

    Raises
    ------
    MissingChannel : a run has no torque or no q-axis current of the test actuator.
    NotIdentifiable : fewer than two distinct levels of current.
    """
    hold_means = gather_means(runs, (CURRENT, TORQUE), usable_channel)
    directed_holds = with_direction(hold_means.value)
    levels = directed_holds.value
    require_levels(error_prefix, "current", CURRENT, levels)
    return Noted(levels, (*hold_means.notes, *directed_holds.notes))


def with_direction(levels: HoldMeans) -> Noted[HoldMeans]:
    """Return the holds with a direction, or all if no hold has one; a note names those that are left out."""
    is_undirected = levels.direction == 0
    if not is_undirected.any() or is_undirected.all():
        return Noted(levels)
    left_out = [hold for hold, lacks in zip(levels.holds, is_undirected, strict=True) if lacks]
    note = f"left out {len(left_out)}: no direction, where other holds have one ({listed(left_out)})"
    return Noted(levels.where(~is_undirected), (note,))


def magnitude(signed: Estimate) -> Estimate:
    """Return the magnitude of a torque whose sign is a convention; an interval around zero then begins at zero."""
    magnitudes = sorted((abs(signed.low), abs(signed.high)))
    low = 0.0 if signed.low <= 0.0 <= signed.high else magnitudes[0]
    return Estimate(signed.name, abs(signed.value), signed.std, low, magnitudes[1], signed.units)


def slopes_by_side(levels: HoldMeans, error_prefix: str, relative_std: float) -> Noted[list[Estimate]]:
    """Estimate the slopes of the rising and of the falling levels alone; a note says why a side gives no slope."""
    slopes, notes = [], []
    for name, sign in SIDES.items():
        side_levels = levels.where(levels.direction == sign)
        columns = {"slope": side_levels.means[CURRENT]}
        try:
            require_levels(error_prefix, "current", CURRENT, side_levels)
            line = fit_lines(columns, side_levels.means[TORQUE], side_levels, error_prefix)
        except NotIdentifiable as fault:
            notes.append(f"{name} levels alone give no slope: {str(fault).removeprefix(error_prefix + ': ')}")
            continue
        units = f"{levels.units[TORQUE]}/A"
        slopes.append(line.estimate("slope", f"torque_constant_{name}", units, relative_std))
    return Noted(slopes, tuple(notes))


def intercepts_by_hold(line: LineFit) -> Array:
    """Return the fitted intercept of each hold's run, in the unit of the fitted values, shape (holds,)."""
    run_index = line.levels.run_index
    return np.asarray(line.fit.coefficients[len(line.slopes) :][np.searchsorted(np.unique(run_index), run_index)])


def plot_of(levels: HoldMeans, line: LineFit) -> Plot:
    """Return the plot of each hold's mean torque by direction, at the runs' mean offset, and of the fitted lines."""
    current, torque = levels.means[CURRENT], levels.means[TORQUE]
    mean_intercept = float(np.mean(line.fit.coefficients[len(line.slopes) :]))
    torque_at_mean_offset: Array = torque - intercepts_by_hold(line) + mean_intercept
    points, lines = [], []
    for label, sign in {**SIDES, "levels": 0}.items():
        on_side = levels.direction == sign
        if on_side.any():
            points.append(
                Series(label, tuple(current[on_side].tolist()), tuple(torque_at_mean_offset[on_side].tolist()))
            )
            end_currents = np.array([current[on_side].min(), current[on_side].max()])
            slopes = dict(zip(line.slopes, line.fit.coefficients, strict=False))
            fitted = (
                slopes["torque_constant"] * end_currents + sign * slopes.get("sticking_torque", 0.0) + mean_intercept
            )
            lines.append(Series(label, tuple(end_currents.tolist()), tuple(fitted.tolist())))
    return Plot("q-axis current [A]", f"torque [{levels.units[TORQUE]}]", tuple(points), tuple(lines))
