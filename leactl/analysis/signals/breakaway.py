"""Breakaway: the torque at which a shaft that stands lets go, from a slow ramp of what drives it.

Before it lets go the torque on the line grows with the drive, after it the torque is that of turning, for some
hundredths of a second the same. The corner between both is fitted, since the highest reading would be one of noise.
"""

from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import Noted, tally
from leactl.analysis.statistics.regression import Array
from leactl.analysis.statistics.trial_means import TrialLabel
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run, Step

BREAKAWAY = "breakaway"
COUNTS = 3.0  # of the encoder, beyond which an angle is motion and not the twist of the shaft
FITTED = 0.2  # of the time from the start of the ramp to the moment of motion, just before it
FEWEST = 20  # readings of torque in it


@dataclass(frozen=True, eq=False)
class Breakaway:
    """One breakaway: its torque, and the readings of the ramp before it."""

    trial: TrialLabel
    torque: float  # N*m, against the motion, the sensor's zero in it
    time: Array  # s, since the shaft moved
    along: Array  # N*m, against the motion


def breakaways_of(run: Run, number: int, torque: Channel) -> Noted[list[Breakaway]]:
    """Return every usable breakaway of run `number`; notes say why others cannot be used."""
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
    """Evaluate the breakaway of one step.

    Raises
    ------
    NotIdentifiable : with the reason why it cannot be used.
    """
    moment, side = motion(step, angle)
    before = (
        (torque.time >= moment - FITTED * (moment - step.start)) & (torque.time < moment) & np.isfinite(torque.values)
    )
    time, opposing = torque.time[before] - moment, -side * torque.values[before]
    if len(time) < FEWEST:
        raise NotIdentifiable(f"fewer than {FEWEST} readings of torque before the shaft moved")
    return Breakaway(TrialLabel(number, side), corner(time, opposing), time, opposing)


def motion(step: Step, angle: Channel) -> tuple[float, int]:
    """Return when the shaft moved by more than a few counts [s], and in which direction, 1 or -1."""
    in_step = (angle.time >= step.start) & (angle.time < step.stop) & np.isfinite(angle.values)
    time, values = angle.time[in_step], angle.values[in_step]
    if len(values) < FEWEST:
        raise NotIdentifiable("no angle is recorded")
    steps = np.diff(np.unique(values))
    threshold = COUNTS * float(steps.min()) if len(steps) else 0.0
    moved = np.flatnonzero(np.abs(values - values[0]) > threshold)
    if not len(moved):
        raise NotIdentifiable("the shaft did not let go: give a higher current")
    if moved[0] < FEWEST:
        raise NotIdentifiable("the shaft turned from the beginning")
    return float(time[moved[0]]), int(np.sign(values[moved[0]] - values[0]))


def corner(time: Array, along: Array) -> float:
    """Fit a ramp that ends in a plateau, over every time of the corner; return the plateau [N*m]."""
    smallest, plateau = np.inf, float("nan")
    for corner_time in time[len(time) // 4 : -2]:
        design = np.column_stack([np.ones_like(time), np.minimum(time - corner_time, 0.0)])
        solution, *_ = np.linalg.lstsq(design, along, rcond=None)
        residual_square = float(np.sum((along - design @ solution) ** 2))
        if residual_square < smallest:
            smallest, plateau = residual_square, float(solution[0])
    return plateau
