"""Thermal guards for supervisors that are made without a run."""

import numpy as np

from leactl.model.motor import load_motor
from leactl.safety.thermal.guard import GuardSettings, ThermalGuard

LEA = load_motor("lea")[0]
SETTINGS = GuardSettings(limit=130.0, ambient=25.0, most_current=30.0, most_speed=40.0, reserve_s=0.22)


def guard_of(roles=("test",), start=28.0, settings=SETTINGS):
    """Of LEA motors in these roles, all nodes at one temperature [degC]."""
    return ThermalGuard(dict.fromkeys(roles, LEA), settings, {role: np.full(3, start) for role in roles})


def passed(guard, period, currents, motion=(0.0, 0.0)):
    """A cycle as a supervisor puts it into the guard's log: currents [A] of some roles, angle and velocity of all."""
    for place, log in enumerate(guard.logs):
        square = currents.get(place, 0.0) ** 2
        log += (period, square * period, *motion)
        guard.flowing[place] = square
