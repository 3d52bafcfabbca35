"""Coast-down: inertia and friction from run-outs with the drive off, by the retardation method (IEC 60034-2-2).

Unpowered, J dw/dt = -(f + b w + c w^2): a run-out alone gives f/J, b/J and c/J, but not the inertia. The current that
held the speed before gives the drag in N*m, and drag over deceleration at that speed is the inertia. The equation is
fitted in its integral form, w = w0 - d t - a int w dt - q int w^2 dt, which takes no derivative of a noisy speed; the
lag of the drive's speed filter is the same in w and in its integrals.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Noted, Plot, Result, Series, joined, tally
from leactl.analysis.experiments.friction import TorqueConstants, torque_constants
from leactl.analysis.quality.sign_checks import refuse_below_zero
from leactl.analysis.quality.usable_readings import usable_channel
from leactl.analysis.quality.wrong_units import unit_notes
from leactl.analysis.signals.levels import HoldSelector, samples_between, settled_mean
from leactl.analysis.statistics.intervals import quantisation_step, rounding_std
from leactl.analysis.statistics.linefit import paths_of, setup_notes
from leactl.analysis.statistics.regression import Array, least_squares
from leactl.analysis.statistics.trial_means import TrialLabel, mean_of
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run, Step

RESULTS = {
    "rotor_inertia": "kg*m^2",
    "coulomb_friction": "N*m",
    "viscous_damping": "N*m*s/rad",
    "quadratic_drag": "N*m*s^2/rad^2",
    "coulomb_over_inertia": "rad/s^2",
    "damping_over_inertia": "1/s",
    "quadratic_over_inertia": "1/rad",
}

CURRENT, VELOCITY, ENABLED = "q_axis_current", "velocity", "drive_enabled"
VELOCITY_HOLDS = HoldSelector("velocity_rad_s", "rad/s")
COAST = "coast"
SLOWEST_SHARE = 0.1  # of the held speed; below it, the filter's lag and sticking change the curve
FEWEST_SAMPLES = 20  # of a run-out
MOST_SPEED_ERROR = 0.05  # of the setpoint; a held velocity that differs by more was not reached
MOST_SPEED_EXCESS = 0.05  # of the held speed; a run-out that is faster by more was driven
UNITS_OVER_INERTIA = {"coulomb": "rad/s^2", "damping": "1/s", "quadratic": "1/rad"}
DRAG_UNITS = {"coulomb_friction": "N*m", "viscous_damping": "N*m*s/rad", "quadratic_drag": "N*m*s^2/rad^2"}


@dataclass(frozen=True, eq=False)
class RunOut:
    """One run-out, whose deceleration at speed w is d + a w + q w^2 [rad/s^2]."""

    trial: TrialLabel
    held_speed: float  # rad/s, magnitude of the speed in the hold before
    current: float  # A, of that hold, along the motion
    rounding: float  # relative standard uncertainty of the current by the steps of its readings, shared by all trials
    time: Array  # s, since the fit's first sample
    speed: Array  # rad/s, magnitude
    fitted: Array  # rad/s, speed of the fit
    coefficients: tuple[float, float, float]  # d [rad/s^2], a [1/s], q [1/rad]

    @property
    def deceleration(self) -> float:
        """Return the deceleration at the held speed [rad/s^2]."""
        d, a, q = self.coefficients
        return d + a * self.held_speed + q * self.held_speed**2


def analyze(
    runs: Sequence[Run],
    *,
    torque_constant: float | None = None,
    torque_constant_std: float | None = None,
    current_gain_std: float | None = None,
) -> Result:
    """Estimate inertia and drag from run-outs and the current before each; without a torque constant, only ratios.

    `rotor_inertia` [kg*m^2], `coulomb_friction` [N*m], `viscous_damping` [N*m*s/rad], `quadratic_drag`
    [N*m*s^2/rad^2], in proportion to the torque constant; from the run-outs alone `coulomb_over_inertia` [rad/s^2],
    `damping_over_inertia` [1/s] and `quadratic_over_inertia` [1/rad]. Each is the mean over both directions, with the
    scatter of the run-outs as its uncertainty.

    Parameters
    ----------
    runs : of one actuator under one condition, free, with steps `coast` after steps that `hold` a velocity.
    torque_constant : [N*m/A], in place of the one in the runs' model.
    torque_constant_std : [N*m/A], its standard uncertainty, which then is part of that of J, b and f.
    current_gain_std : relative, of the current's calibration; see `friction`.

    Raises
    ------
    MissingChannel : a run has no velocity of the test actuator, or no q-axis current.
    NotIdentifiable : no direction has two usable run-outs.
    InputError : a torque constant that is no positive number, an uncertainty below zero, or current and velocity of
        opposite senses.
    """
    error_prefix = f"{paths_of(runs)}: coast-down"
    notes = setup_notes(runs, ("free",), "inertia and drag of whatever else is on the shaft are counted in")
    usable_run_outs = joined(run_outs_of(run, number) for number, run in enumerate(runs))
    run_outs = usable_run_outs.value
    notes += usable_run_outs.notes
    sides = {run_out.trial.side for run_out in run_outs}
    if len(run_outs) <= len(sides) or not run_outs:
        reasons = f" ({'; '.join(notes)})" if notes else ""
        raise NotIdentifiable(
            f"{error_prefix}: found {len(run_outs)} run-outs in {len(sides)} directions{reasons}; "
            "two or more in one direction are needed for their scatter"
        )
    if len(sides) == 1:
        notes.append("run-outs in one direction only: a zero error of the current is part of the inertia")
    trials = [run_out.trial for run_out in run_outs]
    results = []
    try:
        constants = torque_constants(runs, torque_constant, torque_constant_std, current_gain_std)
        notes.append(constants.note.replace("viscous damping", "inertia, viscous damping"))
        results += inertia_and_drag(run_outs, trials, constants)
        refuse_below_zero(results[0], error_prefix, "current and velocity")
    except NotIdentifiable as fault:
        notes.append(f"{fault}; a run-out alone gives no inertia, only what is over it")
        units = {"rotor_inertia": "kg*m^2", **DRAG_UNITS}
        results += [Estimate(name, NAN, NAN, NAN, NAN, unit) for name, unit in units.items()]
    for index, (name, unit) in enumerate(UNITS_OVER_INERTIA.items()):
        values = [run_out.coefficients[index] for run_out in run_outs]
        results.append(mean_of(values, trials, f"{name}_over_inertia", unit))
    notes[:0] = unit_notes(runs, results, [CURRENT], [VELOCITY], torque_constant)
    paths = tuple(str(run.path) for run in runs)
    return Result("coast-down", paths, tuple(results), tuple(notes), (plot_of(run_outs),))


def inertia_and_drag(
    run_outs: Sequence[RunOut], trials: Sequence[TrialLabel], constants: TorqueConstants
) -> list[Estimate]:
    """Estimate the inertia, which is drag torque over deceleration at the held speed, and the drag's coefficients."""
    inertias = [
        float(constants.values[run_out.trial.run]) * run_out.current / run_out.deceleration for run_out in run_outs
    ]
    relative_std = math.hypot(constants.relative_std, max(run_out.rounding for run_out in run_outs))
    results = [mean_of(inertias, trials, "rotor_inertia", "kg*m^2", relative_std)]
    for index, (name, unit) in enumerate(DRAG_UNITS.items()):
        values = [inertia * run_out.coefficients[index] for inertia, run_out in zip(inertias, run_outs, strict=True)]
        results.append(mean_of(values, trials, name, unit, relative_std))
    return results


def run_outs_of(run: Run, number: int) -> Noted[list[RunOut]]:
    """Return the usable run-outs of a run, the `number`-th of all; notes say why others cannot be used."""
    run_outs: list[RunOut] = []
    left_out: dict[str, list[str]] = {}
    steps = run.steps
    velocity, current = (usable_channel(run, name, VELOCITY_HOLDS, fewest_levels=1) for name in (VELOCITY, CURRENT))
    for step in (step for step in steps if step.name == COAST):
        try:
            run_outs.append(run_out_of(run, number, step, velocity.value, current.value))
        except NotIdentifiable as fault:
            left_out.setdefault(str(fault), []).append(f"at {step.start:.1f} s")
    notes = [*velocity.notes, *current.notes]
    if not any(step.name == COAST for step in steps):
        notes.append(f"{run.path}: no step named '{COAST}'")
    return Noted(run_outs, (*notes, *tally(left_out, f"{run.path}")))


def run_out_of(run: Run, number: int, step: Step, velocity: Channel, current: Channel) -> RunOut:
    """Return the fitted run-out of one step `coast`, with speed and current of the hold before it.

    Raises
    ------
    NotIdentifiable : the run-out cannot be used; the message is the reason.
    """
    holds_before = [hold for hold in VELOCITY_HOLDS.holds_of(run) if hold.stop <= step.start + 1e-9]
    if not holds_before:
        raise NotIdentifiable("no held velocity before it")
    held_speed, held_current = (
        settled_mean(channel, holds_before[-1].start, holds_before[-1].stop) for channel in (velocity, current)
    )
    if held_speed is None or held_current is None:
        raise NotIdentifiable("too little velocity or current in the hold before it")
    if held_current.value == 0.0:
        raise NotIdentifiable("no current held the speed before it")
    if abs(held_speed.value - holds_before[-1].setpoint) > MOST_SPEED_ERROR * abs(holds_before[-1].setpoint):
        raise NotIdentifiable("the velocity was not reached in the hold before it")
    direction = 1 if held_speed.value > 0.0 else -1
    coasting = samples_between(velocity, step.start + step.settle, step.stop)
    time, speed = velocity.time[coasting], direction * velocity.values[coasting]
    usable = np.isfinite(speed)
    if run.has(ENABLED):
        enabled = run.channel(ENABLED)
        drive_enabled = (
            np.interp(time, enabled.time, np.nan_to_num(enabled.values)) if len(enabled.time) else np.zeros(len(time))
        )
        if (drive_enabled > 0.0).mean() > 0.5:
            raise NotIdentifiable("the drive was on")
        usable &= drive_enabled == 0.0
    slow_indices = np.flatnonzero(speed < SLOWEST_SHARE * abs(held_speed.value))
    if len(slow_indices):
        usable[slow_indices[0] :] = False
    time, speed = time[usable], speed[usable]
    if len(time) < FEWEST_SAMPLES:
        raise NotIdentifiable(f"fewer than {FEWEST_SAMPLES} readings before the rotor stood: record faster")
    if speed.max() > (1.0 + MOST_SPEED_EXCESS) * abs(held_speed.value):
        raise NotIdentifiable("the rotor was faster than in the hold before it")
    fitted, coefficients = fit_of(time - time[0], speed)
    current_readings = current.values[samples_between(current, holds_before[-1].start, holds_before[-1].stop)]
    rounding = rounding_std(current_readings, quantisation_step(current.values)) / abs(held_current.value)
    current_along_motion = direction * held_current.value
    run_out = RunOut(
        TrialLabel(number, direction),
        abs(held_speed.value),
        current_along_motion,
        rounding,
        time - time[0],
        speed,
        fitted,
        coefficients,
    )
    if run_out.deceleration <= 0.0:
        raise NotIdentifiable("the rotor did not slow down")
    return run_out


def fit_of(time: Array, speed: Array) -> tuple[Array, tuple[float, float, float]]:
    """Return the fitted speed [rad/s], shape (samples,), and the coefficients d, a and q of the deceleration."""
    design = np.column_stack([np.ones_like(time), -time, -integral(speed, time), -integral(speed**2, time)])
    fit = least_squares(design, speed, design, COAST)
    _, constant, linear, quadratic = fit.coefficients.tolist()
    return speed - fit.residuals, (constant, linear, quadratic)


def integral(values: Array, time: Array) -> Array:
    """Return the integral over time up to each sample, by trapezoids with their first correction, shape (samples,).

    Without the correction, J is 0.02 % off in a run-out of 20 readings.
    """
    steps, slope = np.diff(time), np.gradient(values, time)
    areas = 0.5 * steps * (values[1:] + values[:-1]) - steps**2 / 12.0 * np.diff(slope)
    return np.concatenate([[0.0], np.cumsum(areas)])


def plot_of(run_outs: Sequence[RunOut]) -> Plot:
    """Return the plot of every run-out's speed over time, with the fit to the first run-out in each direction."""
    points, lines = [], []
    for label, direction in (("forward", 1), ("backward", -1)):
        same_side = [run_out for run_out in run_outs if run_out.trial.side == direction]
        if same_side:
            time = np.concatenate([run_out.time for run_out in same_side])
            speed = np.concatenate([run_out.speed for run_out in same_side])
            points.append(Series(label, tuple(time.tolist()), tuple(speed.tolist())))
            lines.append(Series(label, tuple(same_side[0].time.tolist()), tuple(same_side[0].fitted.tolist())))
    return Plot("time [s]", "speed [rad/s]", tuple(points), tuple(lines))
