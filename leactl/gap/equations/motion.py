"""Angle against velocity, and the shaft between two actuators."""

import math

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.gap.equations.contract import STAMPED, Equation
from leactl.gap.signals.record import Record
from leactl.gap.signals.smoothing import BASE, middle, slope, smooth
from leactl.gap.signals.stamps import stamp_columns

Array = npt.NDArray[np.float64]
VELOCITY_WIDTH = 4.0


def velocity(record: Record, s: Signals) -> Equation | None:
    """Reported velocity, the model's filter undone = change of the angle."""
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
        restored(middle(measured), filter_constant(s), s.interval) - s.velocity,
        s,
        clock.all_valid(*keys) & s.unleapt & s.resolved,
        {"velocity_reading": lambda c: c},
        {},
        {"velocity_stamp_s": (-slope(s.velocity, s.interval), STAMPED * s.interval)},
        stamp_columns("velocity", clock, keys, s.velocity),
        rounding=rounded_speed(s),
        width=VELOCITY_WIDTH,
        step=8,
    )


def rounded_speed(s: Signals) -> float:
    """Standard deviation [rad/s] that an encoder's counts leave in a row of speed."""
    spread = math.hypot(BASE, VELOCITY_WIDTH)
    return s.count / math.sqrt(12.0) / s.interval * math.sqrt(1.0 / (4.0 * math.sqrt(math.pi) * spread**3))


def filter_constant(s: Signals) -> float:
    """Time constant of the model's velocity filter [s]."""
    return 1 / (2 * np.pi * (s.model.bench.velocity_filter_bandwidth or np.inf))


def load_lag(s: Signals) -> float:
    """How late the load's velocity may be [s]: of its own filter the model says nothing, so it is as the test's."""
    return max(s.interval, filter_constant(s))


def shaft(record: Record, s: Signals) -> Equation | None:
    """Speed of one end against the other = change of the twist, torque / k."""
    clock, stiffness = record.fast, s.model.bench.shaft_stiffness
    if clock is None or s.mechanical != "coupled" or stiffness is None or s.torque is None:
        return None
    load, own = clock.get("velocity", "load"), clock.get("velocity")
    if load is None or own is None:
        return None
    twisting = slope(s.torque, s.interval) / stiffness
    keys = ("velocity", "load"), ("angle", "test")
    return Equation(
        "shaft",
        "velocity",
        "load",
        "rad/s",
        restored(own, filter_constant(s), s.interval) - smooth(load) - twisting,
        s,
        clock.all_valid(*keys) & s.resolved,
        {
            "twist": lambda c: slope(c, s.interval),
            "angle_reading": lambda c: slope(smooth(c), s.interval),
            "velocity_reading": lambda c: c,
        },
        {"bench.shaft_stiffness": -twisting},
        {"load_velocity_lag_s": (slope(smooth(load), s.interval), load_lag(s))},
        stamp_columns("shaft", clock, keys, -smooth(load)),
        width=2.0,
        step=4,
    )


def restored(values: Array, time_constant: float, interval: float) -> Array:
    """A first-order lag undone on what is smoothed."""
    even = smooth(values)
    return even + time_constant * slope(even, interval)


def lock(record: Record, s: Signals) -> Equation | None:
    """Angle of a locked rotor = where it was locked + torque / k.

    Where the shaft carries less than the friction, that may be nothing, and the rotor anywhere within a play.
    """
    clock, stiffness = record.fast, s.model.bench.shaft_stiffness
    if clock is None or s.mechanical != "locked" or stiffness is None or s.torque is None:
        return None
    angle = clock.get("angle")
    if angle is None:
        return None
    twist = s.torque / stiffness
    count = clock.counts.get(("angle", "test"), 0.0)
    return Equation(
        "lock",
        "angle",
        "test",
        "rad",
        angle - np.mean(angle) - twist,
        s,
        clock.all_valid(("angle", "test")) & s.unleapt & (np.abs(s.torque) > (s.model.coulomb_friction or 0.0)),
        {"twist": lambda c: c},
        {"bench.shaft_stiffness": -twist},
        nuisance={"lock_angle": (np.ones_like(twist), 0.1)},
        rounding=count / math.sqrt(12.0),
        levels=1.0 + float(np.ptp(angle)) / max(count, 1e-12),
        width=8.0,
        step=16,
    )
