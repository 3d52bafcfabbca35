"""Measure the state from which a replay starts: angle and speed by a straight line through a few samples."""

import numpy as np
import numpy.typing as npt

from leactl.gap.replay.job import Array, Job
from leactl.gap.signals.noise import noise_of

HALF_WINDOW_S = 4e-3  # s on either side of a start: the speed hardly changes, and the encoder steps many times


def half_window(job: Job) -> int:
    """Return the number of samples on either side of a start."""
    return max(1, round(HALF_WINDOW_S / job.clock.interval))


def starting_motion(job: Job, at: npt.NDArray[np.intp]) -> tuple[Array, Array]:
    """Return angle [rad] and speed [rad/s] at some samples, without the encoder's error."""
    clock, half = job.clock, half_window(job)
    offsets = np.arange(-half, half + 1)
    around = np.clip(at[:, None] + offsets, 0, len(clock.time) - 1)
    measured, speeds = clock.get("angle"), clock.get("velocity")
    if measured is not None:
        noise = noise_of(measured)
        for error in job.plant.angle_error:
            measured = measured - error(measured)
        angle = measured[around].mean(axis=1)
        weights = offsets / (np.sum(offsets**2) * clock.interval)
        velocity = measured[around] @ weights
        spread = noise * float(np.sqrt(np.sum(weights**2)))
    elif speeds is not None:
        angle, velocity = np.zeros(len(at)), speeds[around].mean(axis=1)
        noise = 0.0
        spread = noise_of(speeds) / np.sqrt(len(offsets))
    else:
        return np.zeros(len(at)), np.zeros(len(at))
    if job.disturbance is not None:
        angle = angle + noise / np.sqrt(len(offsets)) * job.disturbance.standard_normal(len(at))
        velocity = velocity + spread * job.disturbance.standard_normal(len(at))
    return np.asarray(angle, np.float64), np.asarray(velocity, np.float64)
