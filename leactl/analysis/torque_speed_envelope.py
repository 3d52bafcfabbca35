"""Torque-speed envelope: the torque that drive, supply and winding give at each speed, driving.

Up to the corner the current limit is what the drive holds. Beyond it back-EMF, resistance and inductance leave the bus
voltage too little for that current, and what flows falls with the speed. The corner is where the fitted speed over the
missing current comes to none missing; nothing is extrapolated beyond the speeds that were driven.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from leactl.analysis.drag import VELOCITY
from leactl.analysis.estimate import NAN, Estimate, Plot, Result, Series, listed
from leactl.analysis.levels import CURRENT_HELD, Levels, gather
from leactl.analysis.linefit import expect_setup, place_of
from leactl.analysis.readings import usable, within_range
from leactl.analysis.regression import Array, least_squares
from leactl.analysis.signs import SWAPPED
from leactl.analysis.torque_constant import CURRENT, TORQUE
from leactl.analysis.trials import Trial, mean_of
from leactl.errors import InputError, NotIdentifiable
from leactl.runfile.reader import Channel, Run

BUS = "bus_voltage"
MISSING = 0.02  # of the current asked for: more, and the voltage is the limit
FEWEST_LIMITED = 4  # holds beyond the corner: one more than its fit has unknowns
SAG = 0.01  # of the bus voltage at its highest
STEADY_RAD_S = 0.1  # between the quarters of a hold
SAME_SPEED = 0.1  # rad/s, of holds that count as repeats; their load settles alike
Mask = npt.NDArray[np.bool_]


def analyze(runs: Sequence[Run]) -> Result:
    """Highest torque and power that were driven, and the speed at which the voltage begins to fail.

    `highest_torque` [N*m] and `highest_power` [W] with `speed_of_highest_torque` and `speed_of_highest_power` [rad/s];
    `corner_speed` [rad/s], without a value where all levels are on one side of it; `current_limit` [A] as asked for;
    `bus_voltage` [V] at its lowest. Of a torque beyond the sensor's range only `low` is told.

    Parameters
    ----------
    runs : of one actuator under one condition, coupled, whose steps `hold` its current at speeds of the load.

    Raises
    ------
    MissingChannel : a run has no torque, velocity or q-axis current of the test actuator.
    NotIdentifiable : no hold in which the actuator drove, holds that ask for different currents, or a current beyond
        what its channel shows.
    InputError : a current against its setpoint.
    """
    place = f"{place_of(runs)}: torque-speed envelope"
    notes = expect_setup(runs, ("coupled",), "another machine has to hold the speed")
    every = gather(runs, (TORQUE, VELOCITY, CURRENT), notes, lambda run, name: readings(run, name, notes))
    levels = driving(every, place, notes)
    asked = np.unique(np.round(np.abs(levels.setpoint), 9))
    if len(asked) > 1:
        raise NotIdentifiable(
            f"{place}: holds ask for {listed(f'{one:g} A' for one in asked)}; one current was expected"
        )
    limit = float(asked[0])
    speed, torque = np.abs(levels.value[VELOCITY]), np.abs(levels.value[TORQUE])
    flowing = np.abs(levels.value[CURRENT])
    limited = flowing < (1.0 - MISSING) * limit
    quarters = levels.quarters[VELOCITY]
    drifted = float(np.max(np.nanmax(quarters, axis=1) - np.nanmin(quarters, axis=1)))
    if drifted > STEADY_RAD_S:
        notes.append(
            f"the speed changed by up to {drifted:.2g} rad/s within a hold: the rotor's inertia is in its torque, and"
            " in no interval; settle longer"
        )
    stops = [abs(value) for run in runs for value in within_range(run.channel(TORQUE), CURRENT_HELD.levels(run))[1]]
    highest = [*best("torque", torque, levels, "N*m", notes), *best("power", torque * speed, levels, "W", notes)]
    if stops:
        notes.append(f"the torque sensor stops at {max(stops):g} N*m: the highest torque lies above, and power may")
        highest = [above(one, max(stops)) for one in highest]
    results = [
        *highest,
        corner(speed, limit - flowing, limited, notes, place),
        Estimate("current_limit", limit, NAN, NAN, NAN, "A"),
        *bus(runs, notes),
    ]
    notes.append("an error in the calibration of the torque sensor is a factor on torque and power")
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


def best(name: str, values: Array, levels: Levels, units: str, notes: list[str]) -> list[Estimate]:
    """The highest mean over the repeats of one speed, and that speed."""
    speed = np.abs(levels.value[VELOCITY])
    order = np.argsort(speed)
    group = np.empty(len(speed), np.int64)
    group[order] = np.cumsum(np.concatenate([[0], np.diff(speed[order]) > SAME_SPEED]))
    means = np.bincount(group, values) / np.bincount(group)
    own = group == int(np.argmax(means))
    at = Estimate(f"speed_of_highest_{name}", float(speed[own].mean()), NAN, NAN, NAN, "rad/s")
    trials = [Trial(int(run), 0) for run in levels.run[own]]
    try:
        found = mean_of(values[own].tolist(), trials, f"highest_{name}", units)
    except NotIdentifiable:
        notes.append(f"highest_{name} without a repeat: how it scatters is not known")
        found = Estimate(f"highest_{name}", float(values[own].mean()), NAN, NAN, NAN, units)
    return [found, at]


def corner(speed: Array, missing: Array, limited: Mask, notes: list[str], place: str) -> Estimate:
    """The speed above which the current is not what was asked for."""
    name, unit = "corner_speed", "rad/s"
    if not limited.any():
        top = float(speed.max())
        notes.append(f"the current was as asked for up to {top:.4g} rad/s: the corner lies above")
        return Estimate(name, NAN, NAN, top, np.inf, unit)
    if limited.all():
        low = float(speed.min())
        notes.append(f"the current fell short at every speed: the corner lies below {low:.4g} rad/s")
        return Estimate(name, NAN, NAN, 0.0, low, unit)
    between = float(speed[~limited].max()), float(speed[limited].min())
    if int(limited.sum()) < FEWEST_LIMITED:
        notes.append(
            f"{limited.sum()} holds beyond the corner; {FEWEST_LIMITED} or more tell it closer than its neighbours"
        )
        return Estimate(name, NAN, NAN, min(between), max(between), unit)
    design = np.vander(missing[limited], 3, increasing=True)
    fit = least_squares(design, speed[limited], design, place)
    return fit.estimate(name, unit, np.array([1.0, 0.0, 0.0]))


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
