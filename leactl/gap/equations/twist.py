"""Equations of a shaft's twist against its torque, between two actuators or at a locked one.

The torque is the drive's less the resisting torque of the rotor, computed from model parameters. An error of such a
parameter looks like an error of the stiffness, so that each has a column here: a torque constant 3 % too low would
otherwise be a shaft 3 % too soft.
"""

import math

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.gap.equations.contract import Equation, Place
from leactl.gap.equations.mechanical import (
    SLOW_REACH,
    STICKING_PRIOR,
    derivative_by_constant,
    derivative_by_friction,
    rotor_torques,
    turning_samples,
)
from leactl.gap.equations.motion import filter_constant, load_lag, smooth_without_lag
from leactl.gap.signals.record import Record
from leactl.gap.signals.smoothing import slope, smooth
from leactl.gap.signals.stamps import stamp_columns

Array = npt.NDArray[np.float64]


def shaft_twist(record: Record, s: Signals) -> Equation | None:
    """Return the equation of the speed of one end against the other: rate of the twist, which is torque / k.

    None where the run is not coupled, or a channel or parameter is missing.
    """
    clock, stiffness = record.fast, s.model.bench.shaft_stiffness
    if clock is None or s.mechanical != "coupled" or stiffness is None:
        return None
    load_velocity, test_velocity, torques = clock.get("velocity", "load"), clock.get("velocity"), rotor_torques(s)
    if load_velocity is None or test_velocity is None or torques is None or s.torque is None or s.velocity is None:
        return None
    drive, resisting_columns, resisting_places = torques

    def twist_rate(torque: Array) -> Array:
        """Return the rate of the twist [rad/s] under a torque [N*m]."""
        return slope(torque, s.interval) / stiffness

    def in_twist_rate(place: Place) -> Place:
        """Return the place in this equation of an effect that resists with the torque of `place`."""
        return lambda c: -twist_rate(place(c))

    calibration = {name: -twist_rate(column) for name, column in resisting_columns.items()}
    calibration |= {"torque_constant": twist_rate(drive), "bench.shaft_stiffness": -twist_rate(s.torque)}
    places = {name: in_twist_rate(place) for name, place in resisting_places.items()}
    resisting_angle_error = places["angle_reading"]
    places["angle_reading"] = lambda c: slope(smooth(c), s.interval) + resisting_angle_error(c)
    places["twist"] = lambda c: slope(c, s.interval)
    places["velocity_reading"] = lambda c: c
    keys = ("velocity", "load"), ("q_axis_current", "test"), ("angle", "test")
    return Equation(
        "shaft",
        "velocity",
        "load",
        "rad/s",
        smooth_without_lag(test_velocity, filter_constant(s), s.interval)
        - smooth(load_velocity)
        - twist_rate(s.torque),
        s,
        clock.all_valid(*keys) & s.resolved & turning_samples(s, s.velocity, SLOW_REACH),
        places,
        calibration,
        {"load_velocity_lag_s": (slope(smooth(load_velocity), s.interval), load_lag(s))},
        stamp_columns("shaft", clock, keys, -smooth(load_velocity)),
        width=2.0,
        step=4,
    )


def lock_angle(record: Record, s: Signals) -> Equation | None:
    """Return the equation of a locked rotor's angle: the angle at which it was locked, plus torque / k.

    Samples whose torque does not exceed the Coulomb friction are left out: friction alone may hold the rotor there.
    None where the rotor is not locked, or a channel or parameter is missing.
    """
    clock, stiffness, constant = record.fast, s.model.bench.shaft_stiffness, s.model.torque_constant
    if clock is None or s.mechanical != "locked" or stiffness is None or s.torque is None or constant is None:
        return None
    angle = clock.get("angle")
    if angle is None:
        return None
    twist = s.torque / stiffness
    constant_column, places_in_torque = derivative_by_constant(s, s.torque, constant)

    def in_angle(place: Place) -> Place:
        """Return the place in this equation of an effect on the torque at `place`."""
        return lambda c: place(c) / stiffness

    places = {name: in_angle(place) for name, place in places_in_torque.items()}
    places["twist"] = lambda c: c
    nuisance = {"lock_angle": (np.ones_like(twist), 0.1)}
    if s.model.coulomb_friction:
        nuisance["sticking_lock"] = (derivative_by_friction(s, s.torque) / stiffness, STICKING_PRIOR)
    keys, count = (("q_axis_current", "test"), ("angle", "test")), clock.counts.get(("angle", "test"), 0.0)
    return Equation(
        "lock",
        "angle",
        "test",
        "rad",
        angle - np.mean(angle) - twist,
        s,
        clock.all_valid(*keys) & s.unleapt & (np.abs(s.torque) > (s.model.coulomb_friction or 0.0)),
        places,
        {"torque_constant": constant_column / stiffness, "bench.shaft_stiffness": -twist},
        nuisance,
        rounding=count / math.sqrt(12.0),
        levels=1.0 + float(np.ptp(angle)) / max(count, 1e-12),
        width=8.0,
        step=16,
    )
