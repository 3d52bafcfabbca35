"""Currents and torques that an actuator can carry: continuous ones, and peaks against duration.

Each figure is given three times: guaranteed over the tolerances of the motor file, by the values of the file, and at
the most favourable corner of the box.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.model.motor import Motor
from leactl.safety.thermal.box import Array, Box
from leactl.safety.thermal.temperature_bound import ThermalBound

TIME_STEPS = 400  # up to the longest duration of a peak
CURRENT_COUNT = 200
LEAST_CURRENT_A, HIGHEST_CURRENT_A = 0.5, 500.0
FIRST_STEP_S = 0.02
FOLLOWED_SHARE = 0.5  # of the rise to the limit: a current is followed up to this far above the limit
TURNING, STANDING = 0.0, 1.0
PEAKS_S = (1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 300.0)


@dataclass(frozen=True)
class Carried:
    """A current, or a torque, that takes the hottest phase to its limit."""

    guaranteed: float  # by every actuator inside the tolerances
    nominal: float
    favourable: float


@dataclass(frozen=True)
class ContinuousLimits:
    """Current and torque that may be carried for ever in one kind of motion."""

    motion: str
    speed: float  # rad/s
    current: Carried  # A
    torque: Carried  # N*m


@dataclass(frozen=True)
class Nominal:
    """Currents [A] that take the hottest phase to its limit, by the values of the motor file."""

    slowly: float  # for ever, turning slowly
    standing: float  # for ever, at one angle
    peaks: tuple[float, ...]  # once for each duration, turning slowly
    standing_peaks: tuple[float, ...]  # once for each duration, at one angle


@dataclass(frozen=True)
class Peak:
    """Current and torque that may be carried once, from ambient, for a duration."""

    duration_s: float
    current: Carried  # A
    torque: Carried  # N*m


def continuous_current(motor: Motor, ambient: float, aligned: float, speed: float) -> Carried:
    """Return the current that may be held for ever [A], power invariant.

    Parameters
    ----------
    ambient : degC.
    aligned : `TURNING` or `STANDING`; see `ThermalBound.step`.
    speed : rad/s, for the heat of friction.

    Raises
    ------
    InputError : the motor file has no tolerances.
    """
    settled_hottest = settled_temperature(ambient, aligned, speed)
    return Carried(
        *(current_at_limit(box, box.limit(math.inf, ambient), ambient, settled_hottest) for box in _boxes(motor))
    )


def continuous(motor: Motor, ambient: float, speeds: Sequence[float]) -> list[ContinuousLimits]:
    """Return what may be carried turning slowly, standing, and at each of these speeds [rad/s]; ambient in degC.

    Raises
    ------
    InputError : the motor file has no tolerances.
    """
    motions = [("slowly", TURNING, 0.0), ("standing", STANDING, 0.0)]
    motions += [(f"{speed:g} rad/s", TURNING, speed) for speed in speeds]
    currents = [(name, speed, continuous_current(motor, ambient, aligned, speed)) for name, aligned, speed in motions]
    return [ContinuousLimits(name, speed, current, torque(motor, current)) for name, speed, current in currents]


def peaks(motor: Motor, ambient: float, durations: Sequence[float]) -> list[Peak]:
    """Return the peak for each duration [s] at standstill, from an actuator at ambient; ambient in degC.

    Raises
    ------
    InputError : the motor file has no tolerances.
    """
    by_box = [_peak_currents(box, ambient, durations) for box in _boxes(motor)]
    currents = [Carried(*values) for values in zip(*by_box, strict=True)]
    return [
        Peak(duration, current, torque(motor, current)) for duration, current in zip(durations, currents, strict=True)
    ]


def nominal(motor: Motor, ambient: float, durations: Sequence[float]) -> Nominal:
    """Return the currents by the values of a motor file, which needs no tolerances; ambient in degC, durations in s."""
    box = Box.exact(motor)
    limit, motions = box.limit(math.inf, ambient), (TURNING, STANDING)
    continuous_currents = [
        current_at_limit(box, limit, ambient, settled_temperature(ambient, aligned, 0.0)) for aligned in motions
    ]
    peak_currents = [tuple(_peak_currents(box, ambient, durations, aligned)) for aligned in motions]
    return Nominal(continuous_currents[0], continuous_currents[1], peak_currents[0], peak_currents[1])


def _peak_currents(box: Box, ambient: float, durations: Sequence[float], aligned: float = STANDING) -> list[float]:
    """Return the largest current [A] for each duration [s], by many currents stepped side by side.

    Between two of them it is interpolated along a chord, which lies above the temperature, a convex function of the
    current: the interpolated current is never too large.
    """
    limit = box.limit(math.inf, ambient)
    currents = np.geomspace(LEAST_CURRENT_A, HIGHEST_CURRENT_A, CURRENT_COUNT)
    bound = ThermalBound([box] * CURRENT_COUNT, ambient + box.ambient_rise)
    speeds, alignments = np.zeros(CURRENT_COUNT), np.full(CURRENT_COUNT, aligned)
    followed_up_to = limit + FOLLOWED_SHARE * (limit - ambient)
    is_followed, hottest, previous_time = np.ones(CURRENT_COUNT, bool), np.zeros(CURRENT_COUNT), 0.0
    by_duration = {}
    for time in np.union1d(np.geomspace(FIRST_STEP_S, max(durations), TIME_STEPS), durations):
        bound.step(
            time - previous_time, np.where(is_followed, currents, 0.0) ** 2, alignments, speeds, ambient, delay=0.0
        )
        is_followed &= bound.hottest() < followed_up_to
        hottest, previous_time = np.where(is_followed, bound.hottest(), np.inf), time
        if time in durations:
            by_duration[time] = _highest_below(limit, currents, hottest)
    return [by_duration[duration] for duration in durations]


def _highest_below(limit: float, currents: Array, hottest: Array) -> float:
    """Return the highest current [A] that does not take the hottest phase past the limit [degC].

    It is interpolated up to the lowest current above the limit. If that current is no longer followed, it is the
    highest of `currents` below the limit.

    hottest : temperature of the hottest phase [degC] at each of `currents` [A]; infinite if no longer followed.
    """
    first_above = int(np.argmax(hottest >= limit)) if (hottest >= limit).any() else len(currents)
    if first_above == 0:
        return 0.0
    neighbours = slice(first_above - 1, first_above + 1)
    if first_above == len(currents) or not np.isfinite(hottest[first_above]):
        return float(currents[first_above - 1])
    return float(np.interp(limit, hottest[neighbours], currents[neighbours]))


def torque(motor: Motor, current: Carried) -> Carried:
    """Return the torque of a current [N*m], by the torque constant; saturation is left out."""
    values = (current.guaranteed, current.nominal, current.favourable)
    return Carried(*(motor.torque_constant * value for value in values))


def settled_temperature(ambient: float, aligned: float, speed: float) -> Callable[[ThermalBound, float], float]:
    """Return a function for the temperature at which the hottest phase settles [degC] under a constant current [A].

    Ambient in degC, speed in rad/s, `aligned` as in `ThermalBound.step`.
    """

    def hottest(bound: ThermalBound, current: float) -> float:
        bound.settle(np.array([current**2]), np.array([aligned]), np.array([speed]), ambient)
        return float(bound.hottest()[0])

    return hottest


def current_at_limit(
    box: Box, limit: float, ambient: float, settled_hottest: Callable[[ThermalBound, float], float]
) -> float:
    """Return the current [A] that takes the hottest phase to its limit; 0 if `LEAST_CURRENT_A` takes it there.

    settled_hottest : a function of `settled_temperature`.
    """
    from scipy.optimize import brentq

    bound = ThermalBound([box], ambient)

    def excess(current: float) -> float:
        return min(settled_hottest(bound, current), 1e6) - limit

    highest_tried = LEAST_CURRENT_A
    while excess(highest_tried) < 0.0:
        highest_tried *= 2.0
    return (
        float(brentq(excess, 0.5 * highest_tried, highest_tried, xtol=1e-4)) if highest_tried > LEAST_CURRENT_A else 0.0
    )


def _boxes(motor: Motor) -> tuple[Box, Box, Box]:
    """Return the box of a motor file, its nominal values and its favourable corner, in the order of `Carried`."""
    return Box.of(motor), Box.exact(motor), Box.favourable(motor)
