"""Equations of a shaft's twist against its torque, between two actuators or at a locked one.

The torque is the drive's less the resisting torque of the rotor, computed from model parameters. An error of one of
them looks like an error of the stiffness, so each has a column here: a torque constant 3 % too low would otherwise be a
shaft 3 % too soft.
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
    """Speed of one end against the other = change of the twist, torque / k."""
    clock, stiffness = record.fast, s.model.bench.shaft_stiffness
    if clock is None or s.mechanical != "coupled" or stiffness is None:
        return None
    load, test_velocity, parts = clock.get("velocity", "load"), clock.get("velocity"), rotor_torques(s)
    if load is None or test_velocity is None or parts is None or s.torque is None or s.velocity is None:
        return None
    drive, resisting, places_against = parts

    def twisting(torque: Array) -> Array:
        return slope(torque, s.interval) / stiffness

    def opposed(place: Place) -> Place:
        return lambda c: -twisting(place(c))

    calibration = {name: -twisting(column) for name, column in resisting.items()}
    calibration |= {"torque_constant": twisting(drive), "bench.shaft_stiffness": -twisting(s.torque)}
    places = {name: opposed(place) for name, place in places_against.items()}
    of_inertia = places["angle_reading"]
    places["angle_reading"] = lambda c: slope(smooth(c), s.interval) + of_inertia(c)
    places["twist"] = lambda c: slope(c, s.interval)
    places["velocity_reading"] = lambda c: c
    keys = ("velocity", "load"), ("q_axis_current", "test"), ("angle", "test")
    return Equation(
        "shaft",
        "velocity",
        "load",
        "rad/s",
        smooth_without_lag(test_velocity, filter_constant(s), s.interval) - smooth(load) - twisting(s.torque),
        s,
        clock.all_valid(*keys) & s.resolved & turning_samples(s, s.velocity, SLOW_REACH),
        places,
        calibration,
        {"load_velocity_lag_s": (slope(smooth(load), s.interval), load_lag(s))},
        stamp_columns("shaft", clock, keys, -smooth(load)),
        width=2.0,
        step=4,
    )


def lock_angle(record: Record, s: Signals) -> Equation | None:
    """Angle of a locked rotor = where it was locked + torque / k.

    Samples whose torque does not exceed the Coulomb friction are left out: friction alone may hold the rotor there.
    """
    clock, stiffness, constant = record.fast, s.model.bench.shaft_stiffness, s.model.torque_constant
    if clock is None or s.mechanical != "locked" or stiffness is None or s.torque is None or constant is None:
        return None
    angle = clock.get("angle")
    if angle is None:
        return None
    twist = s.torque / stiffness
    constant_column, on_torque = derivative_by_constant(s, s.torque, constant)

    def twisted(place: Place) -> Place:
        return lambda c: place(c) / stiffness

    places = {name: twisted(place) for name, place in on_torque.items()}
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
