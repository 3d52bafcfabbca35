"""Back-drive: what it takes to turn the unpowered actuator from outside, by the torque sensor alone.

The analysis needs no current and no torque constant. It estimates breakaway from standstill, drag over speed (drag.py)
and the torque that depends on the angle (cogging.py). The sensor is between the machines, so that it does not see the
friction of the driving machine; the zero of the sensor cancels between both directions.
"""

from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Noted, Plot, Result, Series, joined
from leactl.analysis.experiments.friction import points_by_direction
from leactl.analysis.experiments.torque_constant import TORQUE, intercepts_by_hold
from leactl.analysis.quality.calibration_uncertainty import calibration_notes, gain_std
from leactl.analysis.quality.sign_checks import refuse_below_zero
from leactl.analysis.quality.usable_readings import usable_channel
from leactl.analysis.quality.wrong_units import unit_notes
from leactl.analysis.signals.breakaway import Breakaway, breakaways_of
from leactl.analysis.signals.cogging import cogging_of, turns_of
from leactl.analysis.signals.drag import (
    VELOCITY,
    coefficients,
    drag_at,
    fit_drag,
    holds_at_setpoint,
    turned_both_ways,
    weights_at,
)
from leactl.analysis.signals.levels import HoldMeans, HoldSelector, gather_means
from leactl.analysis.statistics.linefit import LineFit, fit_notes, paths_of, setup_notes
from leactl.analysis.statistics.trial_means import mean_of
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Run

RESULTS = {
    "breakaway_torque": "N*m",
    "viscous_damping": "N*m*s/rad",
    "coulomb_friction": "N*m",
    "quadratic_drag": "N*m*s^2/rad^2",
    "cogging_order": "1",
    "cogging_amplitude": "N*m",
    "cogging_peak_to_peak": "N*m",
}

VELOCITY_HOLDS = HoldSelector("velocity_rad_s", "rad/s", "load")
ENABLED = "drive_enabled"
LINE_POINTS = 40  # of a fitted line in the figure


def analyze(runs: Sequence[Run], *, torque_gain_std: float | None = None) -> Result:
    """Estimate breakaway torque, drag over speed and cogging of an unpowered actuator.

    `breakaway_torque` [N*m], `coulomb_friction` [N*m], `viscous_damping` [N*m*s/rad], `quadratic_drag`
    [N*m*s^2/rad^2], `cogging_order` (periods a turn), `cogging_amplitude` [N*m] of that order, `cogging_peak_to_peak`
    [N*m]. Breakaway and cogging need steps `breakaway` and `turn` in the runs.

    Parameters
    ----------
    runs : of one actuator under one condition, coupled, its drive off, whose steps `hold` a velocity of the load.
    torque_gain_std : relative standard uncertainty of the torque's calibration; by default that of the channel.

    Raises
    ------
    MissingChannel : a run has no torque, velocity or angle of the test actuator.
    NotIdentifiable : the test drive was on, or fewer than four speeds at which the shaft turned steadily.
    InputError : an uncertainty below zero, or torque and motion of opposite senses.
    """
    error_prefix = f"{paths_of(runs)}: back-drive"
    notes = setup_notes(runs, ("coupled",), "another machine has to turn the shaft")
    torque_std = gain_std(runs, TORQUE, torque_gain_std)
    for run in runs:
        refuse_powered(run)
    torques = {run.path: usable_channel(run, TORQUE, VELOCITY_HOLDS) for run in runs}
    hold_means = gather_means(
        runs,
        (VELOCITY, TORQUE),
        lambda run, name: (
            Noted(torques[run.path].value) if name == TORQUE else usable_channel(run, name, VELOCITY_HOLDS)
        ),
        VELOCITY_HOLDS,
    )
    steady_holds = holds_at_setpoint(runs, hold_means.value, error_prefix)
    levels = steady_holds.value
    notes += [note for torque in torques.values() for note in torque.notes]
    notes += [*hold_means.notes, *steady_holds.notes]
    line = fit_drag(levels, -levels.means[TORQUE], error_prefix)
    top_speed = float(np.max(np.abs(levels.setpoint)))
    refuse_below_zero(
        line.fit.estimate("drag", "N*m", weights_at(line, top_speed)), error_prefix, "torque and velocity"
    )
    notes += fit_notes(line, levels.standard_errors[TORQUE], "N*m")
    if not turned_both_ways(levels):
        notes.append("the shaft turned one way only: the zero of the torque sensor is part of coulomb_friction")

    numbered_runs = [(number, run, torques[run.path].value) for number, run in enumerate(runs)]
    breakaways = joined(breakaways_of(run, number, torque) for number, run, torque in numbered_runs)
    damping = line.slope("viscous_damping")
    turns = joined(turns_of(run, number, torque, damping) for number, run, torque in numbered_runs)
    notes += [*breakaways.notes, *turns.notes]
    results = []
    if breakaways.value:
        breakaway_torque = breakaway(breakaways.value, torque_std)
        refuse_below_zero(breakaway_torque.value, error_prefix, "torque and angle")
        results.append(breakaway_torque.value)
        notes += breakaway_torque.notes
    results += coefficients(line, torque_std)
    plots = [plot_of_drag(levels, line)]
    if turns.value:
        try:
            cogging = cogging_of(turns.value, torque_std)
            cogging_results, plot = cogging.value
            results += cogging_results
            plots += [plot] if plot is not None else []
            notes += cogging.notes
        except NotIdentifiable as fault:
            notes.append(str(fault))
    notes += calibration_notes({"the torque sensor": torque_std}, "all torques")
    notes[:0] = unit_notes(runs, results, [TORQUE], [VELOCITY])
    paths = tuple(str(run.path) for run in runs)
    return Result("back-drive", paths, tuple(results), tuple(notes), tuple(plots))


def refuse_powered(run: Run) -> None:
    """Raise NotIdentifiable if the test drive was on in a hold: the sensor would read its torque too."""
    if not run.has(ENABLED):
        return
    enabled = run.channel(ENABLED)
    for hold in VELOCITY_HOLDS.holds_of(run):
        in_hold = (enabled.time >= hold.start) & (enabled.time < hold.stop)
        if np.any(enabled.values[in_hold] > 0.0):
            raise NotIdentifiable(f"{run.path}: the test drive was on at {hold.start:.1f} s; back-drive is unpowered")


def breakaway(breakaways: Sequence[Breakaway], gain_std: float) -> Noted[Estimate]:
    """Estimate the mean breakaway torque over both directions; without a repeat it has no interval.

    `gain_std` is the relative standard uncertainty of the torque's calibration.
    """
    trials, torques = [release.trial for release in breakaways], [release.torque for release in breakaways]
    notes = []
    if len({trial.side for trial in trials}) == 1:
        notes.append("breakaway in one direction only: the zero of the torque sensor is part of it")
    try:
        estimate = mean_of(torques, trials, "breakaway_torque", "N*m", gain_std)
    except NotIdentifiable:
        notes.append("breakaway without a repeat: how it scatters is not known")
        estimate = Estimate("breakaway_torque", float(np.mean(torques)), NAN, NAN, NAN, "N*m")
    return Noted(estimate, tuple(notes))


def plot_of_drag(levels: HoldMeans, line: LineFit) -> Plot:
    """Return the plot of the torque against the motion over speed, by direction, with the fit."""
    velocity = levels.means[VELOCITY]
    sensor_zeros = intercepts_by_hold(line)
    torque_against = (-levels.means[TORQUE] - (sensor_zeros if turned_both_ways(levels) else 0.0)) * np.sign(velocity)
    points = points_by_direction(velocity, torque_against)
    speeds = np.linspace(0.0, float(np.max(np.abs(velocity))), LINE_POINTS)
    fitted = Series("fit", tuple(speeds.tolist()), tuple(drag_at(line.fit, line, speeds).tolist()))
    return Plot("speed [rad/s]", "torque against the motion [N*m]", points, (fitted,))
