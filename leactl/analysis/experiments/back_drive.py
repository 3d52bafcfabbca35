"""Back-drive: what it takes to turn the unpowered actuator from outside, by the torque sensor alone.

No current and no torque constant is in it: breakaway from standstill, drag by speed (drag.py), and what goes with the
angle (cogging.py). The sensor is between the machines, so that the driving one's friction is in nothing; the zero of
the sensor cancels between both directions.
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
LINE_POINTS = 40  # speeds of a line in the figure


def analyze(runs: Sequence[Run], *, torque_gain_std: float | None = None) -> Result:
    """Estimate breakaway torque, drag over speed and cogging of an unpowered actuator.

    `breakaway_torque` [N*m], `coulomb_friction` [N*m], `viscous_damping` [N*m*s/rad], `quadratic_drag`
    [N*m*s^2/rad^2], `cogging_order` (periods a turn), `cogging_amplitude` [N*m] of that order, `cogging_peak_to_peak`
    [N*m]. Breakaway and cogging need steps of that kind in the runs.

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
    gain = gain_std(runs, TORQUE, torque_gain_std)
    for run in runs:
        refuse_powered(run)
    torques = {run.path: usable_channel(run, TORQUE, VELOCITY_HOLDS) for run in runs}
    gathered = gather_means(
        runs,
        (VELOCITY, TORQUE),
        lambda run, name: (
            Noted(torques[run.path].value) if name == TORQUE else usable_channel(run, name, VELOCITY_HOLDS)
        ),
        VELOCITY_HOLDS,
    )
    turning = holds_at_setpoint(runs, gathered.value, error_prefix)
    levels = turning.value
    notes += [note for torque in torques.values() for note in torque.notes]
    notes += [*gathered.notes, *turning.notes]
    line = fit_drag(levels, -levels.means[TORQUE], error_prefix)
    fastest = float(np.max(np.abs(levels.setpoint)))
    refuse_below_zero(line.fit.estimate("drag", "N*m", weights_at(line, fastest)), error_prefix, "torque and velocity")
    notes += fit_notes(line, levels.standard_errors[TORQUE], "N*m")
    if not turned_both_ways(levels):
        notes.append("the shaft turned one way only: the zero of the torque sensor is part of coulomb_friction")

    numbered = [(number, run, torques[run.path].value) for number, run in enumerate(runs)]
    breakaways = joined(breakaways_of(run, number, torque) for number, run, torque in numbered)
    damping = line.slope("viscous_damping")
    turns = joined(turns_of(run, number, torque, damping) for number, run, torque in numbered)
    notes += [*breakaways.notes, *turns.notes]
    results = []
    if breakaways.value:
        released = breakaway(breakaways.value, gain)
        refuse_below_zero(released.value, error_prefix, "torque and angle")
        results.append(released.value)
        notes += released.notes
    results += coefficients(line, gain)
    plots = [plot_of_drag(levels, line)]
    if turns.value:
        try:
            cogging = cogging_of(turns.value, gain)
            cogging_results, plot = cogging.value
            results += cogging_results
            plots += [plot] if plot is not None else []
            notes += cogging.notes
        except NotIdentifiable as fault:
            notes.append(str(fault))
    notes += calibration_notes({"the torque sensor": gain}, "all torques")
    notes[:0] = unit_notes(runs, results, [TORQUE], [VELOCITY])
    paths = tuple(str(run.path) for run in runs)
    return Result("back-drive", paths, tuple(results), tuple(notes), tuple(plots))


def refuse_powered(run: Run) -> None:
    """Refuse a run whose test drive let current flow while the shaft was turned: its torque is in the sensor's.

    Raises
    ------
    NotIdentifiable : the test drive was on.
    """
    if not run.has(ENABLED):
        return
    enabled = run.channel(ENABLED)
    for hold in VELOCITY_HOLDS.holds_of(run):
        part = (enabled.time >= hold.start) & (enabled.time < hold.stop)
        if np.any(enabled.values[part] > 0.0):
            raise NotIdentifiable(f"{run.path}: the test drive was on at {hold.start:.1f} s; back-drive is unpowered")


def breakaway(breakaways: Sequence[Breakaway], gain_std: float) -> Noted[Estimate]:
    """Estimate the mean breakaway torque over both directions; it has no interval without a repeat."""
    trials, values = [release.trial for release in breakaways], [release.torque for release in breakaways]
    notes = []
    if len({trial.side for trial in trials}) == 1:
        notes.append("breakaway in one direction only: the zero of the torque sensor is part of it")
    try:
        estimate = mean_of(values, trials, "breakaway_torque", "N*m", gain_std)
    except NotIdentifiable:
        notes.append("breakaway without a repeat: how it scatters is not known")
        estimate = Estimate("breakaway_torque", float(np.mean(values)), NAN, NAN, NAN, "N*m")
    return Noted(estimate, tuple(notes))


def plot_of_drag(levels: HoldMeans, line: LineFit) -> Plot:
    """Plot the torque against the motion over speed, by direction, with the fit."""
    velocity = levels.means[VELOCITY]
    sensor_zeros = intercepts_by_hold(line)
    torque_against = (-levels.means[TORQUE] - (sensor_zeros if turned_both_ways(levels) else 0.0)) * np.sign(velocity)
    points = points_by_direction(velocity, torque_against)
    speeds = np.linspace(0.0, float(np.max(np.abs(velocity))), LINE_POINTS)
    fitted = Series("fit", tuple(speeds.tolist()), tuple(drag_at(line.fit, line, speeds).tolist()))
    return Plot("speed [rad/s]", "torque against the motion [N*m]", points, (fitted,))
