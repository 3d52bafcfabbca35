"""Torque-speed envelope: the torque that drive, supply and winding give at each speed, driving.

Up to the corner, the drive holds its current limit. Beyond it, back-EMF, resistance and inductance take so much of the
bus voltage that the current falls with the speed (corner.py). If the speed still changes within a hold, the torque of
the rotor's inertia is added. The error of the sensor's zero is the same in every torque, since all have one sign.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Noted, Plot, Result, Series, listed
from leactl.analysis.experiments.torque_constant import CURRENT, TORQUE
from leactl.analysis.quality.calibration_uncertainty import calibration_notes, gain_std
from leactl.analysis.quality.sign_checks import SIGN_SWAPPED
from leactl.analysis.quality.usable_readings import usable_channel, within_range
from leactl.analysis.run_model import rotor_inertia_of_model
from leactl.analysis.signals.corner import Mask, SpeedHolds, corner_speed, repeats_of, speed_groups
from leactl.analysis.signals.drag import VELOCITY
from leactl.analysis.signals.levels import CURRENT_HOLDS, HoldMeans, gather_means
from leactl.analysis.statistics.intervals import quantisation_step
from leactl.analysis.statistics.linefit import DRIFT_P_VALUE, paths_of, setup_notes
from leactl.analysis.statistics.regression import (
    Array,
    indicator_columns,
    least_squares,
    partial_f_test,
    t_quantile,
    widened_by,
)
from leactl.errors import InputError, NotIdentifiable
from leactl.runfile.read.reader import Channel, Run

RESULTS = {
    "highest_torque": "N*m",
    "speed_of_highest_torque": "rad/s",
    "highest_power": "W",
    "speed_of_highest_power": "rad/s",
    "corner_speed": "rad/s",
    "current_limit": "A",
    "bus_voltage": "V",
}

BUS = "bus_voltage"
VOLTAGE_LIMITED_ABOVE = 0.02  # of the setpoint; if more is missing from the current, the voltage limits it
CURRENT_HELD_WITHIN = 0.002  # of the setpoint; if less is missing from the current, the drive held it
HELD_STANDARD_ERRORS = 4.0  # of a mean current; if fewer are missing, the drive held it
MOST_SAG = 0.01  # of the highest bus voltage; a note names a larger sag
MOST_SPEED_CHANGE = 0.005  # of the highest speed; a note names a larger difference of the quarters of a hold
INERTIA_STD = 0.1  # relative standard uncertainty of the inertia: it may be that of a drawing
FEWEST_AT_REST = 20  # readings of torque before the first step, for the uncertainty of its zero
SAME_READING_WITHIN = 1e-12  # relative rounding error of a mean of equal readings
NORMAL_QUARTILE = 0.6745  # of a normal distribution, in standard deviations


def analyze(runs: Sequence[Run], *, torque_gain_std: float | None = None) -> Result:
    """Estimate the highest driving torque and power, and the speed above which the voltage limits the current.

    `highest_torque` [N*m] and `highest_power` [W] with `speed_of_highest_torque` and `speed_of_highest_power` [rad/s];
    `corner_speed` [rad/s] with the winding as warm as the holds made it, without a value if too few levels are beyond
    it or none is below it; `current_limit` [A], the setpoint; the lowest `bus_voltage` [V]. A torque beyond the
    sensor's range has only a lower bound.

    Parameters
    ----------
    runs : of one actuator under one condition, coupled, whose steps `hold` its current at speeds of the load.
    torque_gain_std : relative standard uncertainty of the torque's calibration; by default that of the channel.

    Raises
    ------
    MissingChannel : a run has no torque, velocity or q-axis current of the test actuator.
    NotIdentifiable : no hold in which the actuator drove, holds with different setpoints of the current, a saturated
        current, or a torque or velocity that hangs.
    InputError : an uncertainty below zero, or a current against its setpoint.
    """
    error_prefix = f"{paths_of(runs)}: torque-speed envelope"
    notes = setup_notes(runs, ("coupled",), "another machine has to hold the speed")
    hold_means = gather_means(runs, (TORQUE, VELOCITY, CURRENT), usable_readings)
    driving_levels = driving_holds(hold_means.value, error_prefix)
    levels = driving_levels.value
    refuse_still(levels, error_prefix)
    setpoints = np.unique(np.round(np.abs(levels.setpoint), 9))
    if len(setpoints) > 1:
        raise NotIdentifiable(
            f"{error_prefix}: holds ask for {listed(f'{current:g} A' for current in setpoints)};"
            " one current was expected"
        )
    setpoint = float(setpoints[0])
    speed, current = np.abs(levels.means[VELOCITY]), np.abs(levels.means[CURRENT])
    is_limited = current < (1.0 - VOLTAGE_LIMITED_ABOVE) * setpoint
    is_held = setpoint - current <= np.maximum(
        CURRENT_HELD_WITHIN * setpoint, HELD_STANDARD_ERRORS * levels.standard_errors[CURRENT]
    )
    inertia_torque = acceleration_torque(runs, levels)
    torque = np.abs(levels.means[TORQUE]) + inertia_torque.value
    sensor_zero = zero_std(runs)
    zero_and_inertia_std = math.hypot(sensor_zero.value, INERTIA_STD * float(np.max(np.abs(inertia_torque.value))))
    shared = SharedUncertainty(zero_and_inertia_std, gain_std(runs, TORQUE, torque_gain_std))
    notes += [*hold_means.notes, *driving_levels.notes, *inertia_torque.notes, *sensor_zero.notes]
    highest_results = [
        *highest_estimates("torque", "N*m", np.ones_like(speed), torque, is_limited, levels, shared),
        *highest_estimates("power", "W", speed, torque, is_limited, levels, shared),
    ]
    notes += [
        f"{result.name} without a repeat: how it scatters is not known"
        for result in highest_results
        if lacks_interval(result)
    ]
    sensor_limits = [
        abs(value) for run in runs for value in within_range(run.channel(TORQUE), CURRENT_HOLDS.holds_of(run))[1]
    ]
    if sensor_limits:
        notes.append(
            f"the torque sensor stops at {max(sensor_limits):g} N*m: the highest torque lies above, and power may"
        )
        highest_results = [as_lower_bound(estimate, max(sensor_limits)) for estimate in highest_results]
    holds = SpeedHolds(speed, current, setpoint, is_limited, is_held, levels.run_index)
    at_corner = corner_speed(runs, holds, error_prefix)
    bus_voltage = lowest_bus_voltage(runs)
    results = [
        *highest_results,
        at_corner.value,
        Estimate("current_limit", setpoint, NAN, NAN, NAN, "A"),
        *bus_voltage.value,
    ]
    notes += [*at_corner.notes, *drift_of(holds, at_corner.value), *bus_voltage.notes]
    notes += calibration_notes({"the torque sensor": shared.gain}, "torque and power")
    paths = tuple(str(run.path) for run in runs)
    return Result("torque-speed-envelope", paths, tuple(results), tuple(notes), (plot_of(speed, torque, is_limited),))


def driving_holds(levels: HoldMeans, error_prefix: str) -> Noted[HoldMeans]:
    """Return the holds in which the actuator gave mechanical power; a note names the other holds.

    Raises
    ------
    NotIdentifiable : no hold is left.
    InputError : the current is opposite to its setpoint in most holds.
    """
    current_along_setpoint = levels.means[CURRENT] * levels.setpoint
    if np.mean(current_along_setpoint < 0.0) > 0.5:
        raise InputError(
            f"{error_prefix}: the current is opposite to its setpoint in {(current_along_setpoint < 0.0).sum()} holds;"
            f" {SIGN_SWAPPED}"
        )
    gives_power = (levels.means[TORQUE] * levels.means[VELOCITY] > 0.0) & (
        levels.setpoint * levels.means[VELOCITY] > 0.0
    )
    other_holds = [hold for hold, drives in zip(levels.holds, gives_power, strict=True) if not drives]
    if not gives_power.any():
        raise NotIdentifiable(f"{error_prefix}: found no hold in which the actuator drove ({len(other_holds)} holds)")
    note = f"left out {len(other_holds)}: the actuator gave no power ({listed(other_holds)})"
    return Noted(levels.where(gives_power), (note,) if other_holds else ())


def refuse_still(levels: HoldMeans, error_prefix: str) -> None:
    """Raise NotIdentifiable if torque or velocity has the same mean in all holds of a run.

    Repeats of it would have no scatter, and the highest power too narrow an interval.
    """
    for quantity, run in product((TORQUE, VELOCITY), np.unique(levels.run_index)):
        means = levels.means[quantity][levels.run_index == run]
        if len(means) > 1 and np.ptp(means) <= SAME_READING_WITHIN * abs(means[0]):
            raise NotIdentifiable(
                f"{error_prefix}: {quantity} of test reads {means[0]:.4g} {levels.units[quantity]} in all"
                f" {len(means)} holds: it hangs, or its resolution hides every change"
            )


def usable_readings(run: Run, quantity: str) -> Noted[Channel]:
    """Return a channel with NaN for saturated and repeated readings.

    A saturated current would look like the limit of the drive.

    Raises
    ------
    NotIdentifiable : the current is saturated in a hold, or the torque in all of them.
    """
    if quantity == CURRENT and (range_ends := within_range(run.channel(CURRENT), CURRENT_HOLDS.holds_of(run))[1]):
        limits_text = ", ".join(f"{value:g} A" for value in range_ends)
        raise NotIdentifiable(
            f"{run.path}: {CURRENT} of test is saturated at {limits_text}; what flows beyond is not known"
        )
    return usable_channel(run, quantity, fewest_levels=1)


def as_lower_bound(highest: Estimate, stop: float) -> Estimate:
    """Return a highest torque or power as a lower bound, or its speed as NaN, since the sensor ends at `stop` [N*m]."""
    if highest.name.startswith("speed"):
        return replace(highest, value=NAN)
    low = max(highest.value, stop) if highest.units == "N*m" else highest.value
    return replace(highest, value=NAN, std=NAN, low=low, high=math.inf)


def lacks_interval(estimate: Estimate) -> bool:
    """Return whether an estimate is a highest torque or power without a known scatter."""
    return estimate.name.startswith("highest") and math.isnan(estimate.std)


def acceleration_torque(runs: Sequence[Run], levels: HoldMeans) -> Noted[Array]:
    """Return the torque that accelerated the rotor in each hold, along the motion [N*m]; negative where it slowed."""
    quarters = levels.quarter_means[VELOCITY] * np.sign(levels.means[VELOCITY])[:, np.newaxis]
    middles = (np.arange(4) - 1.5) / 4.0  # of the quarters from the middle of the hold, over its length
    length = np.array([hold.stop - hold.start for hold in levels.holds])
    acceleration = np.nan_to_num(quarters @ middles) / float(middles @ middles) / length
    largest_change = float(np.max(np.nanmax(quarters, axis=1) - np.nanmin(quarters, axis=1)))
    inertias = np.array([rotor_inertia_of_model(run) for run in runs])[levels.run_index]
    notes = []
    if largest_change > MOST_SPEED_CHANGE * float(np.max(np.abs(levels.means[VELOCITY]))):
        is_inertia_unknown = np.isnan(inertias).any()
        unknown_text = "in its torque, and in no interval: give the model a rotor_inertia, or settle longer"
        notes.append(
            f"the speed changed by up to {largest_change:.2g} rad/s within a hold: the rotor's inertia is"
            f" {unknown_text if is_inertia_unknown else 'put back'}"
        )
    return Noted(np.asarray(np.nan_to_num(inertias) * acceleration), tuple(notes))


def zero_std(runs: Sequence[Run]) -> Noted[float]:
    """Return the standard uncertainty of the torque's zero [N*m], by the noise of the readings before the first step.

    It is the largest of all runs, and 0 if no run has enough readings. The noise is taken from differences of
    neighbouring readings, since the zero itself moves while the sensor is tared.
    """
    stds, notes = [], []
    for run in runs:
        torque, steps = run.channel(TORQUE), run.steps
        before_first_step = torque.values[(torque.time < steps[0].start) & np.isfinite(torque.values)]
        if len(before_first_step) < FEWEST_AT_REST:
            notes.append(
                f"{run.path}: no torque at rest before its first step: the uncertainty of its zero is not known"
            )
            continue
        noise = float(np.median(np.abs(np.diff(before_first_step)))) / (NORMAL_QUARTILE * math.sqrt(2.0))
        stds.append(max(noise, quantisation_step(torque.values) / math.sqrt(12.0)) / math.sqrt(len(before_first_step)))
    return Noted(max(stds, default=0.0), tuple(notes))


@dataclass(frozen=True)
class SharedUncertainty:
    """Standard uncertainties that all torques share: of their zero [N*m], and of their gain (relative)."""

    zero: float
    gain: float


def highest_estimates(
    name: str, units: str, factor: Array, torque: Array, limited: Mask, levels: HoldMeans, shared: SharedUncertainty
) -> list[Estimate]:
    """Estimate the highest mean of torque times `factor` over the repeats of one speed, and that speed.

    The scatter is that of repeats at all speeds on the same side of the corner; `limited` is true for holds beyond it.
    Without repeats there is no interval.
    """
    speed = np.abs(levels.means[VELOCITY])
    group_of_hold = speed_groups(speed)
    means = np.bincount(group_of_hold, torque * factor) / np.bincount(group_of_hold)
    at_best_speed = group_of_hold == int(np.argmax(means))
    best_speed = Estimate(f"speed_of_highest_{name}", float(speed[at_best_speed].mean()), NAN, NAN, NAN, "rad/s")
    same_side = limited == limited[np.flatnonzero(at_best_speed)[0]]
    speed_columns = indicator_columns(group_of_hold[same_side])
    try:
        fit = least_squares(speed_columns, torque[same_side], speed_columns, name)
    except NotIdentifiable:
        return [Estimate(f"highest_{name}", float(np.max(means)), NAN, NAN, NAN, units), best_speed]
    fit = widened_by(
        fit, partial_f_test(speed_columns, torque[same_side], indicator_columns(levels.run_index[same_side]))
    )
    weights = (np.unique(group_of_hold[same_side]) == group_of_hold[at_best_speed][0]) * float(
        factor[at_best_speed].mean()
    )
    value, scatter_std = fit.combination(weights)
    shared_std = value * math.hypot(shared.gain, shared.zero / float(torque[at_best_speed].mean()))
    half_width = math.hypot(t_quantile(fit.dof) * scatter_std, t_quantile(math.inf) * shared_std)
    std = math.hypot(scatter_std, shared_std)
    return [Estimate(f"highest_{name}", value, std, value - half_width, value + half_width, units), best_speed]


def drift_of(holds: SpeedHolds, corner: Estimate) -> list[str]:
    """Return a note if the corner speed drifts over the repeats by more than chance and more than its interval.

    A change of resistance shifts the current in proportion to the current. That shift at the setpoint, over the slope
    of the current by speed, is the drift of the corner.
    """
    if math.isnan(corner.value):
        return []
    speed, current, repeat = holds.speed[holds.limited], holds.current[holds.limited], repeats_of(holds)[holds.limited]
    speed_beyond = speed - corner.value
    current_slope = float((holds.setpoint - current) @ speed_beyond / (speed_beyond @ speed_beyond))  # A for each rad/s
    speeds, repeats = indicator_columns(speed_groups(speed)), indicator_columns(repeat)
    mean_current = speeds @ (speeds.T @ current / speeds.sum(axis=0))
    corner_shift = (speed + current / current_slope) * holds.setpoint / mean_current
    if (drift_test := partial_f_test(speeds, corner_shift, repeats)) is None or drift_test.p_value > DRIFT_P_VALUE:
        return []
    corner_drift = float(np.linalg.lstsq(np.hstack([speeds, repeats[:, 1:]]), corner_shift, rcond=None)[0][-1])
    if abs(corner_drift) < corner.high - corner.low:
        return []
    return [
        f"the corner drifts by {corner_drift:+.2g} rad/s from the first repeat to the last: the winding warms, or the"
        " supply sags; corner_speed is that of their mean, and its interval that of a mean"
    ]


def lowest_bus_voltage(runs: Sequence[Run]) -> Noted[list[Estimate]]:
    """Return the lowest bus voltage of the runs; an empty list if none is recorded."""
    readings = [channel.values[np.isfinite(channel.values)] for run in runs for channel in run.channels(BUS)]
    readings = [values for values in readings if len(values)]
    if not readings:
        return Noted([], ("no bus_voltage is recorded: the envelope is of an unknown supply",))
    low, high = min(float(values.min()) for values in readings), max(float(values.max()) for values in readings)
    note = f"the supply sagged from {high:.4g} to {low:.4g} V: the envelope is the supply's too"
    return Noted([Estimate(BUS, low, NAN, NAN, NAN, "V")], (note,) if low < (1.0 - MOST_SAG) * high else ())


def plot_of(speed: Array, torque: Array, limited: Mask) -> Plot:
    """Return the plot of the torque over speed, by what limited it, with a line through all holds."""
    points = []
    for label, in_series in (("current limit", ~limited), ("voltage limit", limited)):
        if in_series.any():
            points.append(Series(label, tuple(speed[in_series].tolist()), tuple(torque[in_series].tolist())))
    order = np.argsort(speed)
    line = Series("envelope", tuple(speed[order].tolist()), tuple(torque[order].tolist()))
    return Plot("speed [rad/s]", "torque [N*m]", tuple(points), (line,))
