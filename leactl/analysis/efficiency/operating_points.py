"""Settled means at every point of a grid of speeds and opposing currents, and which points the bench did not hold.

A point is a step `hold` that tells a velocity and a current; its `role` is that of the current, whose actuator is
driven, the other one drives.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import NAN, tally
from leactl.analysis.quality.usable_readings import fresh, within_range
from leactl.analysis.signals.levels import Hold, Mean, settled_mean
from leactl.analysis.statistics.regression import Array
from leactl.errors import MissingChannel, NotIdentifiable
from leactl.runfile.read.reader import Channel, Run

OTHER = {"test": "load", "load": "test"}
HELD = 0.02  # of the setpoint: how far a mean may be off it
OPPOSITE = 0.5  # of the setpoint: what goes against it by more has its sign swapped
STEADY = 0.02  # of the mean: how far the means of the quarters of a settled part may lie apart
Place = tuple[str, str]  # quantity and role


@dataclass(frozen=True)
class GridHold:
    """One point of the grid, held once."""

    run: int
    speed: float  # rad/s, as asked for
    current: float  # A, of the driven actuator, as asked for
    driving: str
    pass_number: int
    hold: Hold

    def __str__(self) -> str:
        return f"{self.speed:g} rad/s {self.current:g} A"


@dataclass(frozen=True, eq=False)
class Points:
    """Every hold of the grid; element k of each array belongs to one, NaN where the bench did not hold it."""

    holds: tuple[GridHold, ...]
    value: Mapping[Place, Array]  # settled means; no entry where a run has no such channel
    std: Mapping[Place, Array]  # their standard errors
    zero_std: Array  # N*m, of the torque sensor's zero in each run

    @property
    def run(self) -> npt.NDArray[np.int64]:
        """Number of each hold's run."""
        return np.array([one.run for one in self.holds])

    def shifted(self, place: Place) -> "Points":
        """One channel moved by its standard error."""
        return replace(self, value={**self.value, place: self.value[place] + self.std[place]})

    def where(self, kept: npt.NDArray[np.bool_]) -> "Points":
        """Only some of the holds."""
        return replace(
            self,
            holds=tuple(one for one, keep in zip(self.holds, kept, strict=True) if keep),
            value={place: column[kept] for place, column in self.value.items()},
            std={place: column[kept] for place, column in self.std.items()},
        )


def gather(runs: Sequence[Run], notes: list[str]) -> Points:
    """Means of every hold of the grid of some runs; why one is left out goes into the notes.

    Raises
    ------
    MissingChannel : a run has no torque, or no velocity.
    NotIdentifiable : a run has no such hold.
    """
    holds: list[GridHold] = []
    columns: dict[Place, list[tuple[float, float]]] = {}
    zeros = []
    for number, run in enumerate(runs):
        own = grid_holds(run, number)
        if not own:
            raise NotIdentifiable(
                f"{run.path}: found no step 'hold' with velocity_rad_s and current_A; a grid is needed"
            )
        channels = channels_of(run, own, notes)
        zero, zero_std = zero_of(run, channels["torque", "test"], notes)
        zeros.append(zero_std)
        reasons: dict[str, list[str]] = {}
        for one, found in zip(own, means_of(own, channels, reasons), strict=True):
            torque, std = found["torque", "test"]
            found["torque", "test"] = torque - zero, std
            for place in set(columns) | set(found):
                row = columns.setdefault(place, [(NAN, NAN)] * len(holds))
                row.append(found.get(place, (NAN, NAN)))
            holds.append(one)
        notes += tally(reasons, f"{run.path}")
    pairs = {place: np.array(rows) for place, rows in columns.items()}
    value = {place: rows[:, 0] for place, rows in pairs.items()}
    errors = {place: rows[:, 1] for place, rows in pairs.items()}
    return Points(tuple(holds), value, errors, np.array(zeros))


def grid_holds(run: Run, number: int = 0) -> list[GridHold]:
    """The points of a run's grid, in order."""
    found = []
    for step in run.steps:
        told = [step.parameters.get(key) for key in ("velocity_rad_s", "current_A")]
        numeric = [isinstance(one, int | float) and not isinstance(one, bool) and math.isfinite(one) for one in told]
        role = step.parameters.get("role")
        if step.name == "hold" and all(numeric) and role in OTHER:
            speed, current = (float(one) for one in told)  # type: ignore[arg-type]
            hold = Hold(current, 0, step.start + step.settle, step.stop)
            repeat = step.parameters.get("repeat", 1)
            found.append(GridHold(number, speed, current, OTHER[str(role)], int(repeat), hold))
    return found


def channels_of(run: Run, holds: Sequence[GridHold], notes: list[str]) -> dict[Place, Channel]:
    """Channels of a run that a power is made of; only what is no repeat and no end of range."""
    spans = [one.hold for one in holds]
    found = {("torque", "test"): run.channel("torque", role="test")}
    for quantity in ("velocity", "q_axis_current", "q_axis_voltage"):
        found |= {(quantity, role): run.channel(quantity, role=role) for role in OTHER if run.has(quantity, role)}
    if not any(place[0] == "velocity" for place in found):
        raise MissingChannel(f"{run.path}: no velocity of test or load")
    if not any(place[0] == "q_axis_current" for place in found):
        raise MissingChannel(f"{run.path}: no q_axis_current of test or load")
    by_speed = [replace(one.hold, setpoint=one.speed) for one in holds]
    for (quantity, role), channel in found.items():
        kept, ends = within_range(channel, by_speed if quantity == "velocity" else spans)
        for value, reached in ends.items():
            where = f"{quantity} of {role} is saturated at {value:g} in {len(reached)} holds"
            notes.append(f"{run.path}: {where}, which do not count")
        found[quantity, role] = fresh(kept, spans, notes, str(run.path))
    absent = [role for role in OTHER if ("q_axis_current", role) not in found]
    notes += [f"{run.path}: no current of the {role} actuator, so there is no efficiency of it" for role in absent]
    return found


def means_of(
    holds: Sequence[GridHold], channels: Mapping[Place, Channel], reasons: dict[str, list[str]]
) -> list[dict[Place, tuple[float, float]]]:
    """Mean and standard error of each channel in each hold, NaN throughout where it was not held."""
    every = [
        {place: settled_mean(channel, one.hold.start, one.hold.stop) for place, channel in channels.items()}
        for one in holds
    ]
    found = []
    for one, means in zip(holds, every, strict=True):
        why = fault_of(one, means)
        if why:
            reasons.setdefault(why, []).append(str(one))
        found.append(
            {place: (NAN, NAN) if why or mean is None else (mean.value, mean.std) for place, mean in means.items()}
        )
    return found


def fault_of(one: GridHold, means: Mapping[Place, Mean | None]) -> str:
    """Why a hold does not count; empty where it does."""
    lacking = sorted({place[0] for place, mean in means.items() if mean is None})
    if lacking:
        return f"too little {' and '.join(lacking)} in the settled part"
    there = {place: mean for place, mean in means.items() if mean is not None}
    for place, mean in there.items():
        asked = one.speed if place[0] == "velocity" else one.current
        follows = place[0] == "velocity" or place == ("q_axis_current", OTHER[one.driving])
        if follows and mean.value * asked < 0.0 and abs(mean.value) > OPPOSITE * abs(asked):
            return f"{place[0]} of {place[1]} has the opposite sign of its setpoint"
        if follows and abs(mean.value - asked) > HELD * abs(asked):
            return f"{place[0]} was not reached"
    for place, mean in there.items():
        moved = float(np.nanmax(mean.quarters) - np.nanmin(mean.quarters))
        if place[0] != "q_axis_voltage" and moved > STEADY * abs(mean.value):  # a voltage rises as the winding warms
            return f"{place[0]} was not steady"
    return ""


def zero_of(run: Run, torque: Channel, notes: list[str]) -> tuple[float, float]:
    """What the torque sensor shows without torque, and its standard error [N*m]: the mean over the steps `zero`."""
    found = [settled_mean(torque, step.start + step.settle, step.stop) for step in run.steps if step.name == "zero"]
    means = [mean for mean in found if mean is not None]
    if not means:
        notes.append(f"{run.path}: no step 'zero' with drives off; the torque sensor's zero is taken as exact")
        return 0.0, 0.0
    return float(np.mean([mean.value for mean in means])), float(
        np.sqrt(np.sum([mean.std**2 for mean in means])) / len(means)
    )
