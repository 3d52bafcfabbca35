"""State from which a replay starts: angle and speed by a straight line through a few measured samples."""

import numpy as np
import numpy.typing as npt

from leactl.gap.replay.job import Array, Job
from leactl.gap.signals.noise import noise_of

HALF_WINDOW_S = 4e-3  # s on either side of a start: the speed hardly changes, and the encoder steps many times


def half_window(job: Job) -> int:
    """Return the number of samples on either side of a start."""
    return max(1, round(HALF_WINDOW_S / job.clock.interval))


def starting_motion(job: Job, starts: npt.NDArray[np.intp]) -> tuple[Array, Array]:
    """Return angle [rad] and speed [rad/s] at some samples, without the encoder's error; zero where not measured.

    A disturbed replay adds the error of the straight line.
    """
    clock, half_width = job.clock, half_window(job)
    offsets = np.arange(-half_width, half_width + 1)
    window = np.clip(starts[:, None] + offsets, 0, len(clock.time) - 1)
    angles, speeds = clock.get("angle"), clock.get("velocity")
    if angles is not None:
        angle_noise = noise_of(angles)
        for error in job.plant.angle_error:
            angles = angles - error(angles)
        angle = angles[window].mean(axis=1)
        weights = offsets / (np.sum(offsets**2) * clock.interval)
        velocity = angles[window] @ weights
        velocity_noise = angle_noise * float(np.sqrt(np.sum(weights**2)))
    elif speeds is not None:
        angle, velocity = np.zeros(len(starts)), speeds[window].mean(axis=1)
        angle_noise = 0.0
        velocity_noise = noise_of(speeds) / np.sqrt(len(offsets))
    else:
        return np.zeros(len(starts)), np.zeros(len(starts))
    if job.disturbance is not None:
        angle = angle + angle_noise / np.sqrt(len(offsets)) * job.disturbance.standard_normal(len(starts))
        velocity = velocity + velocity_noise * job.disturbance.standard_normal(len(starts))
    return np.asarray(angle, np.float64), np.asarray(velocity, np.float64)
