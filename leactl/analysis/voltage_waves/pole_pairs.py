"""Number of pole pairs: electrical angle over shaft angle, with the uncertainty of the shaft's sensors."""

import math
from typing import NamedTuple

import numpy as np

from leactl.analysis.signals.levels import samples_between, standard_error
from leactl.analysis.voltage_waves.waves import Angle, Array
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run

FEWEST_SAMPLES = 10  # of the shaft's angle or velocity over the counted waves
MOST_OFF_WHOLE = 0.01  # of the count; largest distance from a whole number if its uncertainty is small


class ShaftMotion(NamedTuple):
    """Motion of the shaft over the counted waves."""

    rotation: float  # rad, signed
    std: float  # rad, standard uncertainty of `rotation`
    ripple: float  # amplitude of the speed at twice the electrical frequency over its mean; 0 within noise


def shaft_motion(run: Run, angle: Angle) -> ShaftMotion:
    """Return the motion of the shaft over the whole waves of an electrical angle, by either actuator's encoder.

    Raises
    ------
    NotIdentifiable : no angle or velocity of the shaft is recorded over these waves, or it shows no clear rotation.
    """
    start, stop = float(angle.edges[0]), float(angle.edges[-1])
    for quantity in ("angle", "velocity"):
        for role in ("test", "load"):
            for channel in run.channels(quantity, role):
                samples = samples_between(channel, start, stop)
                if np.isfinite(channel.values[samples]).sum() >= FEWEST_SAMPLES:
                    motion = (
                        motion_by_angle(channel, angle)
                        if quantity == "angle"
                        else motion_by_velocity(channel, start, stop)
                    )
                    if abs(motion.rotation) > 10.0 * motion.std:
                        return motion
    raise NotIdentifiable("the run does not show how far the shaft turned: no angle and no velocity that moved")


def motion_by_angle(channel: Channel, angle: Angle) -> ShaftMotion:
    """Return the motion of the shaft by an encoder's angle."""
    finite = np.isfinite(channel.values)
    time, values = channel.time[finite], channel.values[finite]
    start, stop = float(angle.edges[0]), float(angle.edges[-1])
    rotation = float(np.diff(np.interp([start, stop], time, values))[0])
    interval = float(np.median(np.diff(time)))
    speed = rotation / (stop - start)
    angle_steps = np.diff(np.unique(values))
    resolution = float(angle_steps.min()) if len(angle_steps) else math.inf
    # the errors at each end are uniform: up to a count, and up to a sampling interval of the time stamp
    std = math.sqrt(2.0 / 12.0) * math.hypot(resolution, speed * interval)
    in_waves = (time >= start) & (time <= stop)
    return ShaftMotion(rotation, std, ripple_of(angle.at(time[in_waves]), values[in_waves], rotation, angle))


def ripple_of(electrical_angle: Array, shaft_angle: Array, rotation: float, angle: Angle) -> float:
    """Return the relative amplitude of the speed at twice the electrical frequency; 0 if noise explains it.

    `electrical_angle` and `shaft_angle` [rad] are those at each reading of the encoder, shape (readings,); `rotation`
    is that of the shaft over all waves [rad].
    """
    waves = len(angle.edges) - 1
    if len(shaft_angle) < 5.0 * waves:  # too few readings in a wave to resolve the ripple
        return 0.0
    design = np.column_stack(
        [
            np.ones_like(shaft_angle),
            electrical_angle,
            electrical_angle**2,
            np.cos(2.0 * electrical_angle),
            np.sin(2.0 * electrical_angle),
        ]
    )
    design[:, 2] -= np.polynomial.Polynomial.fit(electrical_angle, electrical_angle**2, 1)(electrical_angle)
    solution = np.linalg.lstsq(design, shaft_angle, rcond=None)[0]
    residuals = shaft_angle - design @ solution
    noise = math.sqrt(float(residuals @ residuals) / len(residuals) * 2.0 / len(residuals))
    amplitude = math.hypot(solution[3], solution[4])
    return 2.0 * amplitude * 2.0 * math.pi * waves / abs(rotation) if amplitude > 4.0 * noise else 0.0


def motion_by_velocity(channel: Channel, start: float, stop: float) -> ShaftMotion:
    """Return the motion of the shaft from `start` to before `stop` [s] by its mean velocity; its ripple is 0."""
    values = channel.values[samples_between(channel, start, stop)]
    duration = stop - start
    return ShaftMotion(float(np.nanmean(values)) * duration, standard_error(values) * duration, 0.0)


def waves_per_turn(waves: int, shaft: ShaftMotion) -> tuple[float, float]:
    """Return the number of waves in each turn of the shaft, and its standard uncertainty."""
    count = 2.0 * math.pi * waves / abs(shaft.rotation)
    return count, count * shaft.std / abs(shaft.rotation)


def whole_pole_pairs(count: float, std: float, error_prefix: str) -> int:
    """Return the whole number of pole pairs nearest to a count.

    Raises
    ------
    NotIdentifiable : the count is not near a whole number, or its uncertainty allows several.
    """
    if std > 0.2:
        raise NotIdentifiable(
            f"{error_prefix}: {count:.2f} waves a turn, known to {std:.2g}: the shaft's speed is not known well enough"
        )
    nearest_count = round(count)
    if (
        nearest_count < 1
        or abs(count - nearest_count) > max(3.0 * std, MOST_OFF_WHOLE * nearest_count)
        or abs(count - nearest_count) > 0.4
    ):
        raise NotIdentifiable(
            f"{error_prefix}: {count:.3f} waves a turn are no whole number of pole pairs: the encoder's counts per turn"
            " or the converter's rate are not what they are taken for"
        )
    return nearest_count
