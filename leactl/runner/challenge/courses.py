"""Courses of current and angle that a bench could run, each made of genes between 0 and 1.

A rotor is accelerated by no more than the bench's largest current; the current is constant within a cycle. Courses of
each kind heat one phase more than their samples suggest: they keep step with the rotor, or with the samples.
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
LONGEST_ANGLE_STEP_S = 0.00025  # longest time between two angles of the plant
LEAST_CURRENT_SHARE = 0.25  # least base current of a course over the bench's largest current
AT_REST_S = 0.15  # time without current at the beginning, which a drive takes to follow its setpoint
INSTANT_S = 1e-7  # step to either side for the derivative of an angle


@dataclass(frozen=True)
class ChallengeCourse:
    """Currents and angles of a course, and the readings of the rotor; arrays without a shape have shape (cycles,)."""

    kind: str
    interval: float  # s, length of a cycle
    currents: Array  # A
    passed_angles: Array  # rad, that the rotor passes in each cycle, shape (cycles, parts)
    angles: Array  # rad, as read at the end of each cycle
    velocities: Array  # rad/s, as read at the end of each cycle


def course(
    genes: Array, motor: Motor, settings: GuardSettings, interval: float, seconds: float, reading: str
) -> ChallengeCourse:
    """Return the course of some genes.

    Parameters
    ----------
    genes : numbers from 0 to 1, shape (GENES,).
    interval : length of a cycle [s].
    seconds : length of the course.
    reading : one of `READINGS`.
    """
    kind = KINDS[int(genes[0] * len(KINDS))]
    cycles, parts = max(int(seconds / interval), 8), max(4, math.ceil(interval / LONGEST_ANGLE_STEP_S))
    angle_at = _motion(kind, genes, motor, settings, interval)
    cycle_starts: Array = interval * np.arange(cycles, dtype=np.float64)
    part_middles: Array = (np.arange(cycles * parts, dtype=np.float64) + 0.5) * (interval / parts)
    electrical_angles = motor.pole_pairs * angle_at(cycle_starts + 0.5 * interval)
    swing_share, phase = genes[8], 2.0 * math.pi * genes[9]
    beat_waves = np.cos((0.0, 2.0, 2.0, 1.0)[int(genes[10] * 4.0)] * electrical_angles + phase)
    swings = swing_share * (np.sign(beat_waves) if genes[10] > 0.5 else beat_waves)
    base_current = settings.most_current * (LEAST_CURRENT_SHARE + (1.0 - LEAST_CURRENT_SHARE) * genes[7])
    currents = np.clip(base_current * (1.0 + swings), 0.0, settings.most_current)
    currents[cycle_starts < AT_REST_S] = 0.0
    cycle_ends: Array = cycle_starts + interval
    angles = angle_at(cycle_ends)
    velocities = (angle_at(cycle_ends + INSTANT_S) - angle_at(cycle_ends - INSTANT_S)) / (2.0 * INSTANT_S)
    readings = _readings(reading, genes, motor, interval, angles, velocities)
    return ChallengeCourse(kind, interval, currents, angle_at(part_middles).reshape(cycles, parts), *readings)


def _motion(
    kind: str, genes: Array, motor: Motor, settings: GuardSettings, interval: float
) -> Callable[[Array], Array]:
    """Return the function that gives the angle [rad] at times [s], for a course of this kind."""
    highest_acceleration = motor.torque_constant * settings.most_current / motor.rotor_inertia  # rad/s^2
    half_electrical_turn = math.pi / motor.pole_pairs
    phase = 2.0 * math.pi * genes[6]
    if kind == "detents":
        half_turns = 1 + int(3.0 * genes[1])
        moving_s = math.sqrt(4.0 * half_electrical_turn * half_turns / highest_acceleration) * (
            1.0 + 2.0 * genes[2] ** 2
        )
        period = moving_s * (1.0 + 6.0 * genes[3])
        if genes[4] > 0.3:  # in step with the samples
            period = max(1, math.ceil(period / interval)) * interval
        return lambda time: (
            half_electrical_turn * half_turns * _stepped_turns(time / period + genes[6], moving_s / period)
        )
    if kind == "crawl":
        speed = 0.001 * 10.0 ** (3.0 * genes[1])
        return lambda time: speed * time
    if kind == "ripple":
        speed = min(0.05 * 10.0 ** (2.8 * genes[1]), settings.most_speed)
        harmonic = HARMONICS[int(genes[2] * len(HARMONICS))]
        angular_rate, largest_amplitude = 2.0 * motor.pole_pairs * speed * harmonic, 0.75 / motor.pole_pairs
    elif kind == "swing":
        speed, angular_rate, largest_amplitude = 0.3 * genes[1] ** 3, 2.0 * math.pi * (1.0 + 200.0 * genes[2] ** 2), 0.3
    else:
        period = (1 + int(4.0 * genes[2])) * interval
        speed = 2.0 * genes[1] if genes[4] > 0.5 else half_electrical_turn * (1 + int(2.0 * genes[1])) / period
        speed = min(speed, settings.most_speed)
        angular_rate, largest_amplitude = 2.0 * math.pi / period, 0.3
    amplitude = genes[3] * min(highest_acceleration / angular_rate**2, largest_amplitude)
    return lambda time: speed * time + amplitude * np.sin(angular_rate * time + phase)


def _stepped_turns(turns: Array, share: float) -> Array:
    """Return turns rounded down, with a smooth step of 1 in the first `share` of each turn.

    The step accelerates in its first half and brakes alike in its second.
    """
    whole_turns, turn_share = np.divmod(turns, 1.0)
    step_share = np.clip(turn_share / share, 0.0, 1.0)
    return np.asarray(
        whole_turns + np.where(step_share < 0.5, 2.0 * step_share**2, 1.0 - 2.0 * (1.0 - step_share) ** 2), np.float64
    )


def _readings(
    reading: str, genes: Array, motor: Motor, interval: float, angles: Array, velocities: Array
) -> tuple[Array, Array]:
    """Return angles [rad] and velocities [rad/s] as a drive reports them, for a reading of `READINGS`."""
    severity, first_faulty = genes[11], int(genes[5] * len(angles))
    random = np.random.default_rng(int(1e6 * genes[5]))
    if reading == "noisy":
        angles = angles + 3.0 * severity * math.pi / motor.pole_pairs * random.standard_normal(len(angles))
        if genes[4] > 0.5:
            velocities = np.diff(angles, prepend=angles[0]) / interval
    elif reading == "stuck":
        angles = np.where(np.arange(len(angles)) < first_faulty, angles, angles[first_faulty])
    elif reading == "lost":
        angles = np.where(random.random(len(angles)) < severity, np.nan, angles)
    elif reading == "drifting":
        angles = angles + 10.0 * severity * interval * np.maximum(np.arange(len(angles)) - first_faulty, 0)
    return angles, velocities
