"""Equation of the velocity channel against the angle."""

import math

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.gap.equations.contract import STAMP_TOLERANCE, Equation
from leactl.gap.signals.record import Record
from leactl.gap.signals.smoothing import BASE_WIDTH, interval_means, slope, smooth
from leactl.gap.signals.stamps import stamp_columns

Array = npt.NDArray[np.float64]
VELOCITY_WIDTH = 4.0  # samples, smoothing of the rows


def velocity(record: Record, s: Signals) -> Equation | None:
    """Return the equation of the velocity channel: the reading with the model's filter inverted is the angle's rate.

    None where a channel is missing.
    """
    clock = record.fast
    if clock is None or s.angle is None or s.velocity is None or s.calm_velocity is None:
        return None
    measured = clock.get("velocity")
    if measured is None:
        return None
    keys = ("velocity", "test"), ("angle", "test")
    return Equation(
        "velocity",
        "velocity",
        "test",
        "rad/s",
        smooth_without_lag(interval_means(measured), filter_constant(s), s.interval) - s.velocity,
        s,
        clock.all_valid(*keys) & s.unleapt & s.resolved,
        {"velocity_reading": lambda c: c},
        {},
        {"velocity_stamp_s": (-slope(s.velocity, s.interval), STAMP_TOLERANCE * s.interval)},
        stamp_columns("velocity", clock, keys, s.velocity),
        rounding=speed_noise_of_counts(s),
        width=VELOCITY_WIDTH,
        step=8,
    )


def speed_noise_of_counts(s: Signals) -> float:
    """Return the standard deviation [rad/s] of a row of speed due to the counts of the encoder."""
    width = math.hypot(BASE_WIDTH, VELOCITY_WIDTH)
    return s.count / math.sqrt(12.0) / s.interval * math.sqrt(1.0 / (4.0 * math.sqrt(math.pi) * width**3))


def filter_constant(s: Signals) -> float:
    """Return the time constant [s] of the model's velocity filter; zero without one."""
    return 1 / (2 * np.pi * (s.model.bench.velocity_filter_bandwidth or np.inf))


def load_lag(s: Signals) -> float:
    """Return the prior delay [s] of the load's velocity: that of the test drive, since no model has a load filter."""
    return max(s.interval, filter_constant(s))


def smooth_without_lag(values: Array, time_constant: float, interval: float) -> Array:
    """Return values smoothed, with a first-order lag inverted.

    time_constant, interval : of the lag, and between samples [s].
    """
    smoothed = smooth(values)
    return smoothed + time_constant * slope(smoothed, interval)
