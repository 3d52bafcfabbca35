"""Courses of current and angle that a bench could run, each made of genes between 0 and 1.

A rotor is accelerated by no more than the bench's largest current; the current is constant within a cycle. The kinds
are courses that heat one phase more than their samples suggest: they keep step with the rotor, or with the samples.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.model.motor import Motor
from leactl.safety.thermal.guard import GuardSettings

Array = npt.NDArray[np.float64]
GENES = 12
KINDS = ("ripple", "detents", "swing", "crawl", "in step")
READINGS = ("true", "noisy", "stuck", "lost", "drifting")
HARMONICS = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0)
LONGEST_PART_S = 0.00025  # longest time between two angles of the plant
LEAST_CURRENT_SHARE = 0.25  # of the bench's largest
AT_REST_S = 0.15  # time without current, which a drive takes to follow its setpoint
INSTANT_S = 1e-7  # to either side, for the derivative of an angle


@dataclass(frozen=True)
class ChallengeCourse:
    """Currents and angles of a course, and the readings of the rotor."""

    kind: str
    interval: float  # s
    currents: Array  # A, of each cycle
    passed: Array  # rad that the rotor passes in each cycle, shape (cycles, parts)
    angles: Array  # rad, as read at the end of each
    velocities: Array  # rad/s, the same


def course(
    genes: Array, motor: Motor, settings: GuardSettings, interval: float, seconds: float, reading: str
) -> ChallengeCourse:
    """Return the course of some genes, with readings of one of the kinds `READINGS`."""
    kind = KINDS[int(genes[0] * len(KINDS))]
    cycles, parts = max(int(seconds / interval), 8), max(4, math.ceil(interval / LONGEST_PART_S))
    moves = _motion(kind, genes, motor, settings, interval)
    starts: Array = interval * np.arange(cycles, dtype=np.float64)
    fine: Array = (np.arange(cycles * parts, dtype=np.float64) + 0.5) * (interval / parts)
    electrical = motor.pole_pairs * moves(starts + 0.5 * interval)
    share, phase = genes[8], 2.0 * math.pi * genes[9]
    beats = np.cos((0.0, 2.0, 2.0, 1.0)[int(genes[10] * 4.0)] * electrical + phase)
    swings = share * (np.sign(beats) if genes[10] > 0.5 else beats)
    base = settings.most_current * (LEAST_CURRENT_SHARE + (1.0 - LEAST_CURRENT_SHARE) * genes[7])
    currents = np.clip(base * (1.0 + swings), 0.0, settings.most_current)
    currents[starts < AT_REST_S] = 0.0
    ends: Array = starts + interval
    angles = moves(ends)
    velocities = (moves(ends + INSTANT_S) - moves(ends - INSTANT_S)) / (2.0 * INSTANT_S)
    readings = _read(reading, genes, motor, interval, angles, velocities)
    return ChallengeCourse(kind, interval, currents, moves(fine).reshape(cycles, parts), *readings)


def _motion(
    kind: str, genes: Array, motor: Motor, settings: GuardSettings, interval: float
) -> Callable[[Array], Array]:
    """Return a function for the angle [rad] over time [s]."""
    fastest = motor.torque_constant * settings.most_current / motor.rotor_inertia  # rad/s^2
    half = math.pi / motor.pole_pairs
    phase = 2.0 * math.pi * genes[6]
    if kind == "detents":
        halves = 1 + int(3.0 * genes[1])
        moving = math.sqrt(4.0 * half * halves / fastest) * (1.0 + 2.0 * genes[2] ** 2)
        period = moving * (1.0 + 6.0 * genes[3])
        if genes[4] > 0.3:  # in step with the samples
            period = max(1, math.ceil(period / interval)) * interval
        return lambda time: half * halves * _stepped(time / period + genes[6], moving / period)
    if kind == "crawl":
        speed = 0.001 * 10.0 ** (3.0 * genes[1])
        return lambda time: speed * time
    if kind == "ripple":
        speed = min(0.05 * 10.0 ** (2.8 * genes[1]), settings.most_speed)
        harmonic = HARMONICS[int(genes[2] * len(HARMONICS))]
        rate, most = 2.0 * motor.pole_pairs * speed * harmonic, 0.75 / motor.pole_pairs
    elif kind == "swing":
        speed, rate, most = 0.3 * genes[1] ** 3, 2.0 * math.pi * (1.0 + 200.0 * genes[2] ** 2), 0.3
    else:
        period = (1 + int(4.0 * genes[2])) * interval
        speed = 2.0 * genes[1] if genes[4] > 0.5 else half * (1 + int(2.0 * genes[1])) / period
        speed = min(speed, settings.most_speed)
        rate, most = 2.0 * math.pi / period, 0.3
    amplitude = genes[3] * min(fastest / rate**2, most)
    return lambda time: speed * time + amplitude * np.sin(rate * time + phase)


def _stepped(turns: Array, share: float) -> Array:
    """Round turns down, with a smooth step of 1 in the first `share` of each turn, accelerated and braked alike."""
    whole, part = np.divmod(turns, 1.0)
    moved = np.clip(part / share, 0.0, 1.0)
    return np.asarray(whole + np.where(moved < 0.5, 2.0 * moved**2, 1.0 - 2.0 * (1.0 - moved) ** 2), np.float64)


def _read(
    reading: str, genes: Array, motor: Motor, interval: float, angles: Array, velocities: Array
) -> tuple[Array, Array]:
    """Return angles and velocities as a drive reports them."""
    amount, begins = genes[11], int(genes[5] * len(angles))
    random = np.random.default_rng(int(1e6 * genes[5]))
    if reading == "noisy":
        angles = angles + 3.0 * amount * math.pi / motor.pole_pairs * random.standard_normal(len(angles))
        if genes[4] > 0.5:
            velocities = np.diff(angles, prepend=angles[0]) / interval
    elif reading == "stuck":
        angles = np.where(np.arange(len(angles)) < begins, angles, angles[begins])
    elif reading == "lost":
        angles = np.where(random.random(len(angles)) < amount, np.nan, angles)
    elif reading == "drifting":
        angles = angles + 10.0 * amount * interval * np.maximum(np.arange(len(angles)) - begins, 0)
    return angles, velocities
