"""Number of pole pairs: electrical angle over shaft angle, with the uncertainty of the shaft's sensors."""

import math
from typing import NamedTuple

import numpy as np

from leactl.analysis.signals.levels import samples_between, standard_error
from leactl.analysis.voltage_waves.waves import Angle, Array
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run

FEWEST_SAMPLES = 10  # of the shaft's angle or velocity
MOST_OFF_WHOLE = 0.01  # of the count, from a whole number, where the uncertainty is small


class ShaftMotion(NamedTuple):
    """Motion of the shaft over the counted waves."""

    turned: float  # rad, signed
    std: float  # rad, standard uncertainty of `turned`
    ripple: float  # amplitude of the speed at twice the electrical frequency over its mean; 0 within noise


def shaft_motion(run: Run, angle: Angle) -> ShaftMotion:
    """Measure the rotation of the shaft over the whole waves of an electrical angle, by either actuator's encoder.

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
                    if abs(motion.turned) > 10.0 * motion.std:
                        return motion
    raise NotIdentifiable("the run does not show how far the shaft turned: no angle and no velocity that moved")


def motion_by_angle(channel: Channel, angle: Angle) -> ShaftMotion:
    """Measure the rotation of the shaft, and its ripple, by an encoder's angle."""
    finite = np.isfinite(channel.values)
    time, values = channel.time[finite], channel.values[finite]
    start, stop = float(angle.edges[0]), float(angle.edges[-1])
    turned = float(np.diff(np.interp([start, stop], time, values))[0])
    interval = float(np.median(np.diff(time)))
    speed = turned / (stop - start)
    levels = np.diff(np.unique(values))
    resolution = float(levels.min()) if len(levels) else math.inf
    # the errors at each end are uniform: up to a count, and up to a sampling interval of the time stamp
    std = math.sqrt(2.0 / 12.0) * math.hypot(resolution, speed * interval)
    between = (time >= start) & (time <= stop)
    return ShaftMotion(turned, std, ripple_of(angle.at(time[between]), values[between], turned, angle))


def ripple_of(electrical: Array, shaft: Array, turned: float, angle: Angle) -> float:
    """Return the relative amplitude of the speed at twice the electrical frequency; 0 where noise explains it.

    `electrical` and `shaft` are the angles [rad] at each reading of the encoder, shape (readings,).
    """
    waves = len(angle.edges) - 1
    if len(shaft) < 5.0 * waves:  # too few readings a wave to resolve the ripple
        return 0.0
    design = np.column_stack(
        [np.ones_like(shaft), electrical, electrical**2, np.cos(2.0 * electrical), np.sin(2.0 * electrical)]
    )
    design[:, 2] -= np.polynomial.Polynomial.fit(electrical, electrical**2, 1)(electrical)
    solution = np.linalg.lstsq(design, shaft, rcond=None)[0]
    residuals = shaft - design @ solution
    noise = math.sqrt(float(residuals @ residuals) / len(residuals) * 2.0 / len(residuals))
    amplitude = math.hypot(solution[3], solution[4])
    return 2.0 * amplitude * 2.0 * math.pi * waves / abs(turned) if amplitude > 4.0 * noise else 0.0


def motion_by_velocity(channel: Channel, start: float, stop: float) -> ShaftMotion:
    """Measure the rotation of the shaft from start to before stop [s] by its mean velocity; its ripple is 0."""
    values = channel.values[samples_between(channel, start, stop)]
    duration = stop - start
    return ShaftMotion(float(np.nanmean(values)) * duration, standard_error(values) * duration, 0.0)


def waves_per_turn(waves: int, shaft: ShaftMotion) -> tuple[float, float]:
    """Return the number of waves in each turn of the shaft, and its standard uncertainty."""
    count = 2.0 * math.pi * waves / abs(shaft.turned)
    return count, count * shaft.std / abs(shaft.turned)


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
