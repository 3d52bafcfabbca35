"""Breakaway: the torque at which a shaft at rest begins to turn, from a slow ramp of the driving torque.

Before the shaft turns, the measured torque grows with the drive; afterwards it is the torque of turning, which stays
constant for some hundredths of a second. The corner between ramp and plateau is fitted, since the highest reading would
contain noise.
"""

from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import Noted, tally
from leactl.analysis.statistics.regression import Array
from leactl.analysis.statistics.trial_means import TrialLabel
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run, Step

BREAKAWAY = "breakaway"
LEAST_ENCODER_COUNTS = 3.0  # of motion; a smaller change of angle may be the twist of the shaft
FITTED_SHARE = 0.2  # of the time from the start of the ramp to the motion, up to the motion
FEWEST_READINGS = 20  # of the torque in the fitted time, and of the angle before the motion


@dataclass(frozen=True, eq=False)
class Breakaway:
    """One breakaway: its torque, and the torque readings of the ramp before it."""

    trial: TrialLabel
    torque: float  # N*m, against the motion; the sensor's zero is not subtracted
    time: Array  # s, from the motion of the shaft; negative before it
    opposing_torque: Array  # N*m, readings of the torque against the motion


def breakaways_of(run: Run, number: int, torque: Channel) -> Noted[list[Breakaway]]:
    """Return every usable breakaway of a run, the `number`-th of all; notes say why others cannot be used."""
    angle = run.channel("angle")
    breakaways: list[Breakaway] = []
    left_out: dict[str, list[str]] = {}
    for step in (step for step in run.steps if step.name == BREAKAWAY):
        try:
            breakaways.append(breakaway_of(number, step, angle, torque))
        except NotIdentifiable as fault:
            left_out.setdefault(str(fault), []).append(f"at {step.start:.1f} s")
    return Noted(breakaways, tuple(tally(left_out, f"{run.path}")))


def breakaway_of(number: int, step: Step, angle: Channel, torque: Channel) -> Breakaway:
    """Return the breakaway of one step.

    Raises
    ------
    NotIdentifiable : no motion can be recognised (see `motion`), or there are too few readings of torque before it.
    """
    motion_time, direction = motion(step, angle)
    fit_start = motion_time - FITTED_SHARE * (motion_time - step.start)
    in_fit = (torque.time >= fit_start) & (torque.time < motion_time) & np.isfinite(torque.values)
    time, opposing_torque = torque.time[in_fit] - motion_time, -direction * torque.values[in_fit]
    if len(time) < FEWEST_READINGS:
        raise NotIdentifiable(f"fewer than {FEWEST_READINGS} readings of torque before the shaft moved")
    return Breakaway(TrialLabel(number, direction), plateau_torque(time, opposing_torque), time, opposing_torque)


def motion(step: Step, angle: Channel) -> tuple[float, int]:
    """Return the time [s] at which the shaft has moved by more than `LEAST_ENCODER_COUNTS`, and its direction.

    The direction is 1 or -1.

    Raises
    ------
    NotIdentifiable : too few angles are recorded, or the shaft did not move, or moved from the beginning.
    """
    in_step = (angle.time >= step.start) & (angle.time < step.stop) & np.isfinite(angle.values)
    time, values = angle.time[in_step], angle.values[in_step]
    if len(values) < FEWEST_READINGS:
        raise NotIdentifiable("no angle is recorded")
    angle_steps = np.diff(np.unique(values))
    threshold = LEAST_ENCODER_COUNTS * float(angle_steps.min()) if len(angle_steps) else 0.0
    moved_indices = np.flatnonzero(np.abs(values - values[0]) > threshold)
    if not len(moved_indices):
        raise NotIdentifiable("the shaft did not let go: give a higher current")
    if moved_indices[0] < FEWEST_READINGS:
        raise NotIdentifiable("the shaft turned from the beginning")
    return float(time[moved_indices[0]]), int(np.sign(values[moved_indices[0]] - values[0]))


def plateau_torque(time: Array, opposing_torque: Array) -> float:
    """Fit a ramp that ends in a plateau, trying each sample as the corner; return the best fit's plateau [N*m]."""
    smallest_square, plateau = np.inf, float("nan")
    for corner_time in time[len(time) // 4 : -2]:
        design = np.column_stack([np.ones_like(time), np.minimum(time - corner_time, 0.0)])
        solution, *_ = np.linalg.lstsq(design, opposing_torque, rcond=None)
        residual_square = float(np.sum((opposing_torque - design @ solution) ** 2))
        if residual_square < smallest_square:
            smallest_square, plateau = residual_square, float(solution[0])
    return plateau
