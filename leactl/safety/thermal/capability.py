"""What an actuator can carry: continuous current and torque, and peak current against duration.

Each figure comes three times: guaranteed over the tolerances of the motor file, of the file's own values, and of the
most favourable corner of the box.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from leactl.model.motor import Motor
from leactl.safety.thermal.bound import ThermalBound
from leactl.safety.thermal.box import Box

STEPS = 400  # of time, until peaks are told
CURRENTS = 200
LEAST_A, HARDEST_A = 0.5, 500.0
SOONEST_S = 0.02
TURNING, STANDING = 0.0, 1.0
PEAKS_S = (1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 300.0)


@dataclass(frozen=True)
class Carried:
    """A current, or a torque, that takes the hottest phase to its limit."""

    guaranteed: float  # by every actuator inside the tolerances
    nominal: float
    favourable: float


@dataclass(frozen=True)
class Held:
    """What may be carried for ever in one kind of motion."""

    motion: str
    speed: float  # rad/s
    current: Carried  # A
    torque: Carried  # N*m


@dataclass(frozen=True)
class Peak:
    """What may be carried once, from ambient, for a duration."""

    duration_s: float
    current: Carried  # A
    torque: Carried  # N*m


def continuous_current(motor: Motor, ambient: float, aligned: float, speed: float) -> Carried:
    """Current that may be held for ever [A], power invariant.

    Parameters
    ----------
    ambient : degC.
    aligned : `TURNING` or `STANDING`; see `ThermalBound.step`.
    speed : rad/s, for the heat of friction.

    Raises
    ------
    InputError : the motor file has no tolerances.
    """

    def hottest(bound: ThermalBound, current: float) -> float:
        bound.settle(np.array([current**2]), np.array([aligned]), np.array([speed]), ambient)
        return float(bound.hottest()[0])

    return _each(motor, ambient, hottest)


def continuous(motor: Motor, ambient: float, speeds: Sequence[float]) -> list[Held]:
    """Continuous current and torque turning slowly, standing, and at these speeds [rad/s]; ambient in degC.

    Raises
    ------
    InputError : the motor file has no tolerances.
    """
    kinds = [("slowly", TURNING, 0.0), ("standing", STANDING, 0.0)]
    kinds += [(f"{speed:g} rad/s", TURNING, speed) for speed in speeds]
    found = [(name, speed, continuous_current(motor, ambient, aligned, speed)) for name, aligned, speed in kinds]
    return [Held(name, speed, current, torque(motor, current)) for name, speed, current in found]


def peaks(motor: Motor, ambient: float, durations: Sequence[float]) -> list[Peak]:
    """What may be held for each duration [s] at standstill, the actuator being at ambient before; ambient in degC.

    Raises
    ------
    InputError : the motor file has no tolerances.
    """
    found = [_held_for(box, motor.limits.winding_temperature, ambient, durations) for box in _boxes(motor)]
    currents = [Carried(*values) for values in zip(*found, strict=True)]
    return [Peak(duration, one, torque(motor, one)) for duration, one in zip(durations, currents, strict=True)]


def _held_for(box: Box, limit: float, ambient: float, durations: Sequence[float]) -> list[float]:
    """Many currents side by side until each has reached the limit; then the one that would do so after a duration."""
    currents = np.geomspace(HARDEST_A, LEAST_A, CURRENTS)
    bound = ThermalBound([box] * CURRENTS, ambient + box.ambient_rise)
    last, reached = 0.0, np.full(CURRENTS, np.inf)
    still, standing, before = np.zeros(CURRENTS), np.full(CURRENTS, STANDING), bound.hottest()
    for time in np.geomspace(SOONEST_S, 1.1 * max(durations), STEPS):
        going = np.isinf(reached)
        bound.step(time - last, np.where(going, currents, 0.0) ** 2, standing, still, ambient, late=0.0)
        after = bound.hottest()
        crossed = going & ~(after < limit)
        part = (limit - before[crossed]) / (after[crossed] - before[crossed])
        reached[crossed] = last + part * (time - last)
        last, before = time, after
    told = np.isfinite(reached)
    return [float(np.interp(np.log(d), np.log(reached[told]), currents[told])) for d in durations]


def torque(motor: Motor, current: Carried) -> Carried:
    """Torque of a current [N*m], by the torque constant; saturation is not in it."""
    values = (current.guaranteed, current.nominal, current.favourable)
    return Carried(*(motor.torque_constant * value for value in values))


def _each(motor: Motor, ambient: float, hottest: Callable[[ThermalBound, float], float]) -> Carried:
    limit = motor.limits.winding_temperature
    found = []
    for box in _boxes(motor):
        bound = ThermalBound([box], ambient)

        def over(current: float, bound: ThermalBound = bound) -> float:
            return min(hottest(bound, current), 1e6) - limit

        most = LEAST_A
        while over(most) < 0.0:
            most *= 2.0
        found.append(brentq(over, 0.5 * most, most, xtol=1e-4) if most > LEAST_A else 0.0)
    return Carried(*found)


def _boxes(motor: Motor) -> tuple[Box, Box, Box]:
    return Box.of(motor), Box.exact(motor), Box.favourable(motor)
