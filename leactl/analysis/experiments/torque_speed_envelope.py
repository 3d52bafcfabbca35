"""Torque-speed envelope: the torque that drive, supply and winding give at each speed, driving.

Up to the corner the current limit is what the drive holds. Beyond it back-EMF, resistance and inductance leave the bus
voltage too little for that current, and what flows falls with the speed (corner.py). Where the speed still changes
within a hold, what the rotor's inertia takes or gives is put back. The error of the sensor's zero is in every torque
alike, since all of them have one sign.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Plot, Result, Series, listed
from leactl.analysis.experiments.torque_constant import CURRENT, TORQUE
from leactl.analysis.quality.calibration_uncertainty import doubts, gain_std
from leactl.analysis.quality.sign_checks import SWAPPED
from leactl.analysis.quality.usable_readings import usable, within_range
from leactl.analysis.run_model import rotor_inertia_of_model
from leactl.analysis.signals.corner import Limited, Mask, corner, groups_of, repeats_of
from leactl.analysis.signals.drag import VELOCITY
from leactl.analysis.signals.levels import CURRENT_HELD, Levels, gather
from leactl.analysis.statistics.intervals import step_of
from leactl.analysis.statistics.linefit import DRIFTS_BELOW, expect_setup, place_of
from leactl.analysis.statistics.regression import (
    Array,
    departure,
    judged_by,
    least_squares,
    one_column_each,
    t_quantile,
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
MISSING = 0.02  # of the current asked for: more, and the voltage is the limit
HELD = 0.002  # of it: less, and the drive had all of it
CLEAR = 4.0  # standard errors of a mean current, within which it is as asked for
SAG = 0.01  # of the bus voltage at its highest
STEADY = 0.005  # of the highest speed, between the quarters of a hold
INERTIA_STD = 0.1  # relative standard uncertainty of the inertia: it may be one of a drawing
FEWEST_AT_REST = 20  # readings of torque before the first step, that tell how well its zero is known
SAME_READING = 1e-12  # of it: a mean of equal readings is off by no more
QUARTILE = 0.6745  # of a normal distribution, in standard deviations


def analyze(runs: Sequence[Run], *, torque_gain_std: float | None = None) -> Result:
    """Highest torque and power that were driven, and the speed at which the voltage begins to fail.

    `highest_torque` [N*m] and `highest_power` [W] with `speed_of_highest_torque` and `speed_of_highest_power` [rad/s];
    `corner_speed` [rad/s] of the winding as warm as its holds left it, without a value where all levels are on one side
    of it; `current_limit` [A] as asked for; `bus_voltage` [V] at its lowest. Of a torque beyond the sensor's range only
    `low` is told.

    Parameters
    ----------
    runs : of one actuator under one condition, coupled, whose steps `hold` its current at speeds of the load.
    torque_gain_std : relative standard uncertainty of the torque's calibration; the channel's own unless told.

    Raises
    ------
    MissingChannel : a run has no torque, velocity or q-axis current of the test actuator.
    NotIdentifiable : no hold in which the actuator drove, holds that ask for different currents, a current beyond what
        its channel shows, or a torque or velocity that hangs.
    InputError : an uncertainty below zero, or a current against its setpoint.
    """
    place = f"{place_of(runs)}: torque-speed envelope"
    notes = expect_setup(runs, ("coupled",), "another machine has to hold the speed")
    every = gather(runs, (TORQUE, VELOCITY, CURRENT), notes, lambda run, name: readings(run, name, notes))
    levels = driving(every, place, notes)
    refuse_still(levels, place)
    asked = np.unique(np.round(np.abs(levels.setpoint), 9))
    if len(asked) > 1:
        raise NotIdentifiable(
            f"{place}: holds ask for {listed(f'{one:g} A' for one in asked)}; one current was expected"
        )
    limit = float(asked[0])
    speed, flowing = np.abs(levels.value[VELOCITY]), np.abs(levels.value[CURRENT])
    limited = flowing < (1.0 - MISSING) * limit
    held = limit - flowing <= np.maximum(HELD * limit, CLEAR * levels.std[CURRENT])
    taken = by_inertia(runs, levels, notes)
    torque = np.abs(levels.value[TORQUE]) + taken
    zero = math.hypot(zero_std(runs, notes), INERTIA_STD * float(np.max(np.abs(taken))))
    shared = Shared(zero, gain_std(runs, TORQUE, torque_gain_std))
    highest = [
        *best("torque", "N*m", np.ones_like(speed), torque, limited, levels, shared),
        *best("power", "W", speed, torque, limited, levels, shared),
    ]
    notes += [f"{item.name} without a repeat: how it scatters is not known" for item in highest if no_interval(item)]
    stops = [abs(value) for run in runs for value in within_range(run.channel(TORQUE), CURRENT_HELD.levels(run))[1]]
    if stops:
        notes.append(f"the torque sensor stops at {max(stops):g} N*m: the highest torque lies above, and power may")
        highest = [above(one, max(stops)) for one in highest]
    found = Limited(speed, flowing, limit, limited, held, levels.run)
    at_corner = corner(runs, found, notes, place)
    notes += drift_of(found, at_corner)
    results = [
        *highest,
        at_corner,
        Estimate("current_limit", limit, NAN, NAN, NAN, "A"),
        *bus(runs, notes),
    ]
    notes += doubts({"the torque sensor": shared.gain}, "torque and power")
    paths = tuple(str(run.path) for run in runs)
    return Result("torque-speed-envelope", paths, tuple(results), tuple(notes), (plot_of(speed, torque, limited),))


def driving(levels: Levels, place: str, notes: list[str]) -> Levels:
    """Only holds in which the actuator gave power; others are named.

    Raises
    ------
    NotIdentifiable : there is none.
    InputError : a current against its setpoint in most.
    """
    flows = levels.value[CURRENT] * levels.setpoint
    if np.mean(flows < 0.0) > 0.5:
        raise InputError(f"{place}: the current is opposite to its setpoint in {(flows < 0.0).sum()} holds; {SWAPPED}")
    gives = (levels.value[TORQUE] * levels.value[VELOCITY] > 0.0) & (levels.setpoint * levels.value[VELOCITY] > 0.0)
    braking = [hold for hold, one in zip(levels.holds, gives, strict=True) if not one]
    if not gives.any():
        raise NotIdentifiable(f"{place}: found no hold in which the actuator drove ({len(braking)} holds)")
    if braking:
        notes.append(f"left out {len(braking)}: the actuator gave no power ({listed(braking)})")
    return levels.where(gives)


def refuse_still(levels: Levels, place: str) -> None:
    """A torque or a velocity that never changes, whatever the hold, would leave a highest power without scatter.

    Raises
    ------
    NotIdentifiable : all holds of a run have one reading.
    """
    for quantity, run in product((TORQUE, VELOCITY), np.unique(levels.run)):
        found = levels.value[quantity][levels.run == run]
        if len(found) > 1 and np.ptp(found) <= SAME_READING * abs(found[0]):
            raise NotIdentifiable(
                f"{place}: {quantity} of test reads {found[0]:.4g} {levels.units[quantity]} in all {len(found)} holds:"
                " it hangs, or its resolution hides every change"
            )


def readings(run: Run, quantity: str, notes: list[str]) -> Channel:
    """A channel with what does not count as missed; a current at the end of its range would be taken for a limit.

    Raises
    ------
    NotIdentifiable : the current is there in a hold, or the torque in all of them.
    """
    if quantity == CURRENT and (ends := within_range(run.channel(CURRENT), CURRENT_HELD.levels(run))[1]):
        at = ", ".join(f"{value:g} A" for value in ends)
        raise NotIdentifiable(f"{run.path}: {CURRENT} of test is saturated at {at}; what flows beyond is not known")
    return usable(run, quantity, notes, least=1)


def above(found: Estimate, stop: float) -> Estimate:
    """What is left of a highest figure whose sensor stops at a torque: a bound from below, and no speed."""
    if found.name.startswith("speed"):
        return replace(found, value=NAN)
    low = max(found.value, stop) if found.units == "N*m" else found.value
    return replace(found, value=NAN, std=NAN, low=low, high=math.inf)


def no_interval(item: Estimate) -> bool:
    """Whether it is a highest value that nothing tells the scatter of."""
    return item.name.startswith("highest") and math.isnan(item.std)


def by_inertia(runs: Sequence[Run], levels: Levels, notes: list[str]) -> Array:
    """What of the torque in each hold went into the rotor, along the motion [N*m]: less than nothing where it slows."""
    quarters = levels.quarters[VELOCITY] * np.sign(levels.value[VELOCITY])[:, np.newaxis]
    places = (np.arange(4) - 1.5) / 4.0  # of the quarters' middles, from the middle of the hold, over its length
    length = np.array([hold.stop - hold.start for hold in levels.holds])
    growth = np.nan_to_num(quarters @ places) / float(places @ places) / length
    drifted = float(np.max(np.nanmax(quarters, axis=1) - np.nanmin(quarters, axis=1)))
    inertias = np.array([rotor_inertia_of_model(run) for run in runs])[levels.run]
    if drifted > STEADY * float(np.max(np.abs(levels.value[VELOCITY]))):
        lacking = np.isnan(inertias).any()
        what = "in its torque, and in no interval: give the model a rotor_inertia, or settle longer"
        notes.append(
            f"the speed changed by up to {drifted:.2g} rad/s within a hold: the rotor's inertia is"
            f" {what if lacking else 'put back'}"
        )
    return np.asarray(np.nan_to_num(inertias) * growth)


def zero_std(runs: Sequence[Run], notes: list[str]) -> float:
    """Standard uncertainty of the torque's zero, by the scatter of what it was tared with [N*m]: 0 where nothing tells.

    Readings that follow one another are compared, since the zero itself moves where it is tared.
    """
    found = []
    for run in runs:
        torque, steps = run.channel(TORQUE), run.steps
        rest = torque.values[(torque.time < steps[0].start) & np.isfinite(torque.values)]
        if len(rest) < FEWEST_AT_REST:
            notes.append(f"{run.path}: no torque at rest before its first step: how well its zero is known is not told")
            continue
        noise = float(np.median(np.abs(np.diff(rest)))) / (QUARTILE * math.sqrt(2.0))
        found.append(max(noise, step_of(torque.values) / math.sqrt(12.0)) / math.sqrt(len(rest)))
    return max(found, default=0.0)


@dataclass(frozen=True)
class Shared:
    """Standard uncertainties that every torque has alike: of a zero [N*m], and of a factor."""

    zero: float
    gain: float


def best(
    name: str, units: str, factor: Array, torque: Array, kind: Mask, levels: Levels, shared: Shared
) -> list[Estimate]:
    """The highest mean of torque times a factor over the repeats of one speed, and that speed.

    Repeats of all speeds of one `kind`, on one side of the corner, tell how torques scatter; there is no interval where
    no speed has a repeat.
    """
    speed = np.abs(levels.value[VELOCITY])
    group = groups_of(speed)
    means = np.bincount(group, torque * factor) / np.bincount(group)
    own = group == int(np.argmax(means))
    at = Estimate(f"speed_of_highest_{name}", float(speed[own].mean()), NAN, NAN, NAN, "rad/s")
    alike = kind == kind[np.flatnonzero(own)[0]]
    speeds = one_column_each(group[alike])
    try:
        fit = least_squares(speeds, torque[alike], speeds, name)
    except NotIdentifiable:
        return [Estimate(f"highest_{name}", float(np.max(means)), NAN, NAN, NAN, units), at]
    fit = judged_by(fit, departure(speeds, torque[alike], one_column_each(levels.run[alike])))
    weights = (np.unique(group[alike]) == group[own][0]) * float(factor[own].mean())
    value, scattered = fit.combined(weights)
    alike_std = value * math.hypot(shared.gain, shared.zero / float(torque[own].mean()))
    half = math.hypot(t_quantile(fit.dof) * scattered, t_quantile(math.inf) * alike_std)
    std = math.hypot(scattered, alike_std)
    return [Estimate(f"highest_{name}", value, std, value - half, value + half, units), at]


def drift_of(holds: Limited, found: Estimate) -> list[str]:
    """A note where the corner moves from repeat to repeat by more than chance, and than its interval is wide.

    What a change of resistance does to the current goes with the current itself; over the fall of the current with the
    speed, and at the current asked for, it is how far the corner moves.
    """
    if math.isnan(found.value):
        return []
    speed, current, repeat = holds.speed[holds.limited], holds.current[holds.limited], repeats_of(holds)[holds.limited]
    beyond = speed - found.value
    fall = float((holds.asked - current) @ beyond / (beyond @ beyond))  # A for each rad/s
    speeds, repeats = one_column_each(groups_of(speed)), one_column_each(repeat)
    mean = speeds @ (speeds.T @ current / speeds.sum(axis=0))
    shift = (speed + current / fall) * holds.asked / mean
    if (departs := departure(speeds, shift, repeats)) is None or departs.probability > DRIFTS_BELOW:
        return []
    moved = float(np.linalg.lstsq(np.hstack([speeds, repeats[:, 1:]]), shift, rcond=None)[0][-1])
    if abs(moved) < found.high - found.low:
        return []
    return [
        f"the corner drifts by {moved:+.2g} rad/s from the first repeat to the last: the winding warms, or the supply"
        " sags; corner_speed is that of their mean, and its interval that of a mean"
    ]


def bus(runs: Sequence[Run], notes: list[str]) -> list[Estimate]:
    """The lowest bus voltage while the levels were held; none where it is not recorded."""
    seen = [channel.values[np.isfinite(channel.values)] for run in runs for channel in run.channels(BUS)]
    seen = [values for values in seen if len(values)]
    if not seen:
        notes.append("no bus_voltage is recorded: the envelope is of an unknown supply")
        return []
    low, high = min(float(values.min()) for values in seen), max(float(values.max()) for values in seen)
    if low < (1.0 - SAG) * high:
        notes.append(f"the supply sagged from {high:.4g} to {low:.4g} V: the envelope is the supply's too")
    return [Estimate(BUS, low, NAN, NAN, NAN, "V")]


def plot_of(speed: Array, torque: Array, limited: Mask) -> Plot:
    """Torque over speed by what limited it, and a line through the level means."""
    points = []
    for label, of_it in (("current limit", ~limited), ("voltage limit", limited)):
        if of_it.any():
            points.append(Series(label, tuple(speed[of_it].tolist()), tuple(torque[of_it].tolist())))
    order = np.argsort(speed)
    line = Series("envelope", tuple(speed[order].tolist()), tuple(torque[order].tolist()))
    return Plot("speed [rad/s]", "torque [N*m]", tuple(points), (line,))
