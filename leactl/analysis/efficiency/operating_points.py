"""Settled means at every point of a grid of speeds and opposing currents, and which points the bench did not hold.

A point is a step `hold` whose parameters state a velocity and a current. Its `role` is that of the current: the
actuator of this role is driven, and the actuator of the other role drives.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import NAN, Noted, tally
from leactl.analysis.quality.usable_readings import within_range, without_repeated_readings
from leactl.analysis.signals.levels import Hold, SettledMean, settled_mean
from leactl.analysis.statistics.regression import Array
from leactl.errors import MissingChannel, NotIdentifiable
from leactl.runfile.read.reader import Channel, Run

OTHER_ROLE = {"test": "load", "load": "test"}
MOST_SETPOINT_ERROR = 0.02  # of the setpoint; a mean that differs by more was not reached
LEAST_OPPOSITE_READING = 0.5  # of the setpoint; a larger mean of opposite sign has its sign swapped
MOST_QUARTER_SPREAD = 0.02  # of the mean; a hold whose quarters differ by more was not steady
ChannelKey = tuple[str, str]  # quantity and role of a channel


@dataclass(frozen=True)
class GridHold:
    """One hold of one point of the grid."""

    run: int  # number of the run
    speed: float  # rad/s, setpoint
    current: float  # A, setpoint of the driven actuator
    driving: str  # role of the driving actuator
    pass_number: int
    hold: Hold

    def __str__(self) -> str:
        return f"{self.speed:g} rad/s {self.current:g} A"


@dataclass(frozen=True, eq=False)
class OperatingPoints:
    """Means of every hold of the grid; element k of each array belongs to hold k, NaN where the bench missed it."""

    holds: tuple[GridHold, ...]
    value: Mapping[ChannelKey, Array]  # settled means; no entry if no run has such a channel
    std: Mapping[ChannelKey, Array]  # their standard errors
    zero_std: Array  # N*m, of the torque sensor's zero in each run

    @property
    def run(self) -> npt.NDArray[np.int64]:
        """Return the number of each hold's run, shape (holds,)."""
        return np.array([grid_hold.run for grid_hold in self.holds])

    def shifted(self, key: ChannelKey) -> "OperatingPoints":
        """Return the points with the means of one channel increased by their standard errors."""
        return replace(self, value={**self.value, key: self.value[key] + self.std[key]})

    def where(self, mask: npt.NDArray[np.bool_]) -> "OperatingPoints":
        """Return the holds for which `mask`, of shape (holds,), is true."""
        return replace(
            self,
            holds=tuple(grid_hold for grid_hold, selected in zip(self.holds, mask, strict=True) if selected),
            value={key: column[mask] for key, column in self.value.items()},
            std={key: column[mask] for key, column in self.std.items()},
        )


def gather_grid(runs: Sequence[Run]) -> Noted[OperatingPoints]:
    """Return the means of the channels over every hold of the runs' grids; notes say why a hold is left out.

    Raises
    ------
    MissingChannel : a run has no torque, no velocity, or no current of either actuator.
    NotIdentifiable : a run has no hold with a velocity and a current.
    """
    holds: list[GridHold] = []
    columns: dict[ChannelKey, list[tuple[float, float]]] = {}
    zero_stds = []
    notes: list[str] = []
    for number, run in enumerate(runs):
        run_holds = grid_holds(run, number)
        if not run_holds:
            raise NotIdentifiable(
                f"{run.path}: found no step 'hold' with velocity_rad_s and current_A; a grid is needed"
            )
        channels = channels_of(run, run_holds)
        torque_zero = zero_of(run, channels.value["torque", "test"])
        zero, zero_std = torque_zero.value
        zero_stds.append(zero_std)
        left_out: dict[str, list[str]] = {}
        for grid_hold, means in means_of(run_holds, channels.value):
            if reason := reason_to_leave_out(grid_hold, means):
                left_out.setdefault(reason, []).append(str(grid_hold))
            row = {key: (NAN, NAN) if reason or mean is None else (mean.value, mean.std) for key, mean in means.items()}
            torque, std = row["torque", "test"]
            row["torque", "test"] = torque - zero, std
            for key in set(columns) | set(row):
                columns.setdefault(key, [(NAN, NAN)] * len(holds)).append(row.get(key, (NAN, NAN)))
            holds.append(grid_hold)
        notes += [*channels.notes, *torque_zero.notes, *tally(left_out, f"{run.path}")]
    values_and_errors = {key: np.array(rows) for key, rows in columns.items()}
    value = {key: rows[:, 0] for key, rows in values_and_errors.items()}
    standard_errors = {key: rows[:, 1] for key, rows in values_and_errors.items()}
    return Noted(OperatingPoints(tuple(holds), value, standard_errors, np.array(zero_stds)), tuple(notes))


def grid_holds(run: Run, number: int = 0) -> list[GridHold]:
    """Return the steps `hold` of run `number` that state a role, a velocity and a current, in order."""
    holds = []
    for step in run.steps:
        setpoints = [step.parameters.get(key) for key in ("velocity_rad_s", "current_A")]
        is_number = [
            isinstance(setpoint, int | float) and not isinstance(setpoint, bool) and math.isfinite(setpoint)
            for setpoint in setpoints
        ]
        role = step.parameters.get("role")
        if step.name == "hold" and all(is_number) and role in OTHER_ROLE:
            speed, current = (float(setpoint) for setpoint in setpoints)  # type: ignore[arg-type]
            hold = Hold(current, 0, step.start + step.settle, step.stop)
            repeat = step.parameters.get("repeat", 1)
            holds.append(GridHold(number, speed, current, OTHER_ROLE[str(role)], int(repeat), hold))
    return holds


def channels_of(run: Run, holds: Sequence[GridHold]) -> Noted[dict[ChannelKey, Channel]]:
    """Return the channels that powers are computed from, with NaN for saturated and repeated readings.

    Raises
    ------
    MissingChannel : the run has no torque, no velocity, or no current of either actuator.
    """
    current_holds = [grid_hold.hold for grid_hold in holds]
    channels = {("torque", "test"): run.channel("torque", role="test")}
    for quantity in ("velocity", "q_axis_current", "q_axis_voltage"):
        channels |= {
            (quantity, role): run.channel(quantity, role=role) for role in OTHER_ROLE if run.has(quantity, role)
        }
    if not any(quantity == "velocity" for quantity, _ in channels):
        raise MissingChannel(f"{run.path}: no velocity of test or load")
    if not any(quantity == "q_axis_current" for quantity, _ in channels):
        raise MissingChannel(f"{run.path}: no q_axis_current of test or load")
    speed_holds = [replace(grid_hold.hold, setpoint=grid_hold.speed) for grid_hold in holds]
    notes: list[str] = []
    for (quantity, role), channel in channels.items():
        unsaturated, saturated_holds = within_range(channel, speed_holds if quantity == "velocity" else current_holds)
        for value, at_value in saturated_holds.items():
            notes.append(
                f"{run.path}: {quantity} of {role} is saturated at {value:g} in {len(at_value)} holds, which do not"
                " count"
            )
        without_repeats = without_repeated_readings(unsaturated, current_holds, str(run.path))
        channels[quantity, role] = without_repeats.value
        notes += without_repeats.notes
    roles_without_current = [role for role in OTHER_ROLE if ("q_axis_current", role) not in channels]
    notes += [
        f"{run.path}: no current of the {role} actuator, so there is no efficiency of it"
        for role in roles_without_current
    ]
    return Noted(channels, tuple(notes))


def means_of(
    holds: Sequence[GridHold], channels: Mapping[ChannelKey, Channel]
) -> list[tuple[GridHold, dict[ChannelKey, SettledMean | None]]]:
    """Return the mean of each channel over each hold; None for a channel with too few readings in the hold."""
    return [
        (
            grid_hold,
            {
                key: settled_mean(channel, grid_hold.hold.start, grid_hold.hold.stop)
                for key, channel in channels.items()
            },
        )
        for grid_hold in holds
    ]


def reason_to_leave_out(grid_hold: GridHold, means: Mapping[ChannelKey, SettledMean | None]) -> str:
    """Return the reason to leave out a hold; empty if the hold counts."""
    lacking_quantities = sorted({quantity for (quantity, _), mean in means.items() if mean is None})
    if lacking_quantities:
        return f"too little {' and '.join(lacking_quantities)} in the settled part"
    complete_means = {key: mean for key, mean in means.items() if mean is not None}
    for (quantity, role), mean in complete_means.items():
        setpoint = grid_hold.speed if quantity == "velocity" else grid_hold.current
        follows = quantity == "velocity" or (quantity, role) == ("q_axis_current", OTHER_ROLE[grid_hold.driving])
        if follows and mean.value * setpoint < 0.0 and abs(mean.value) > LEAST_OPPOSITE_READING * abs(setpoint):
            return f"{quantity} of {role} has the opposite sign of its setpoint"
        if follows and abs(mean.value - setpoint) > MOST_SETPOINT_ERROR * abs(setpoint):
            return f"{quantity} was not reached"
    for (quantity, _), mean in complete_means.items():
        spread = float(np.nanmax(mean.quarters) - np.nanmin(mean.quarters))
        # a voltage rises as the winding warms
        if quantity != "q_axis_voltage" and spread > MOST_QUARTER_SPREAD * abs(mean.value):
            return f"{quantity} was not steady"
    return ""


def zero_of(run: Run, torque: Channel) -> Noted[tuple[float, float]]:
    """Return the torque sensor's zero and its standard error [N*m], the mean over the steps `zero`.

    Without such steps both are 0, and a note says so.
    """
    steps = [step for step in run.steps if step.name == "zero"]
    means_of_steps = [settled_mean(torque, step.start + step.settle, step.stop) for step in steps]
    means = [mean for mean in means_of_steps if mean is not None]
    if not means:
        note = f"{run.path}: no step 'zero' with drives off; the torque sensor's zero is taken as exact"
        return Noted((0.0, 0.0), (note,))
    std = float(np.sqrt(np.sum([mean.std**2 for mean in means])) / len(means))
    return Noted((float(np.mean([mean.value for mean in means])), std))
