"""References of the drives in the runs of a case, each drawn at random: levels, dwells, phases, directions.

Kinds of run: `locked_staircase`, `coupled_grid`, `free_multisine`, `free_velocity`, and the currents of `heating`.
"""

import math

import numpy as np

from leactl.emulation.plant.stepped.lanes import Array
from leactl.emulation.plant.stepped.plant import TICK
from leactl.emulation.plant.stepped.run import DriveReferences

MOVING_KINDS = ("locked_staircase", "coupled_grid", "free_multisine", "free_velocity")
RUN_KINDS = (*MOVING_KINDS, "heating")
SETUPS = {
    "locked_staircase": "locked",
    "coupled_grid": "coupled",
    "free_multisine": "free",
    "free_velocity": "free",
    "heating": "heated",
}
TORQUE_CONSTANT, DAMPING, INERTIA = 0.49, 0.0238, 0.0024  # nominal, to choose amplitudes by
Generator = np.random.Generator


def locked_staircase(draw: Generator) -> DriveReferences:
    """Rising and falling levels of both signs with a minor loop, then a fast part."""
    levels = int(draw.integers(4, 7))
    peak, dwell, ramp = draw.uniform(18.0, 24.5), draw.uniform(0.8, 1.4), draw.uniform(0.06, 0.3)
    up = [peak * (k + 1) / levels for k in range(levels)]
    half = [*up, *([up[-2], up[-1]] if draw.random() < 0.5 else []), *up[-2::-1], 0.0]
    first = float(draw.choice([-1.0, 1.0]))
    knots = [first * level for level in half] + [-first * level for level in half]
    stairs = _hold_levels(knots, dwell, ramp)
    fast = _sum_sines(draw, draw.uniform(7.0, 11.0), 0.3, draw.uniform(60.0, 150.0), 30)
    fast *= draw.uniform(1.2, 3.0) / fast.std()
    bias = draw.uniform(-4.0, 4.0)
    return DriveReferences(np.concatenate([stairs, _hold_levels([bias], 0.5, 0.2), np.clip(fast + bias, -20.0, 20.0)]))


def coupled_grid(draw: Generator) -> DriveReferences:
    """The load holds speeds of both signs; at each, the test drive steps through torques of both signs."""
    magnitudes = np.sort(np.exp(draw.uniform(math.log(2.0), math.log(27.0), int(draw.integers(4, 7)))))
    magnitudes[-1] = max(magnitudes[-1], draw.uniform(18.0, 27.0))
    speeds = draw.permutation(np.concatenate([magnitudes, -magnitudes]))
    per_speed = int(draw.integers(4, 7))
    dwell = draw.uniform(40.0, 52.0) / (len(speeds) * per_speed)
    currents = []
    for speed in speeds:
        # the ceiling of 20.9 V less back-EMF and a margin for warm copper
        highest = min(draw.uniform(16.0, 21.0), (19.0 - TORQUE_CONSTANT * abs(speed)) / 0.36)
        currents_at_speed = np.linspace(-highest, highest, per_speed) + draw.uniform(-0.8, 0.8, per_speed)
        currents += list(draw.permutation(currents_at_speed))
    ramp = draw.uniform(0.04, 0.15)
    current = _hold_levels(currents, dwell - ramp, ramp)
    velocity = _hold_levels(np.repeat(speeds, per_speed), dwell - ramp, ramp)
    turn = _limit_slew(velocity, draw.uniform(60.0, 250.0))
    gain = draw.uniform(110.0, 190.0)
    integral = gain * draw.uniform(8.0, 15.0)
    return DriveReferences(current, turn, "load", gain, integral, feedforward=draw.uniform(0.8, 0.97))


def free_multisine(draw: Generator) -> DriveReferences:
    """A current of many sines that turns the rotor back and forth through standstill."""
    duration = draw.uniform(36.0, 44.0)
    current = _sum_sines(draw, duration, draw.uniform(0.03, 0.06), draw.uniform(30.0, 70.0), int(draw.integers(20, 32)))
    slow = _sum_sines(draw, duration, 0.1, 0.6, 4)
    current = current / current.std() * draw.uniform(0.55, 0.8) + slow / slow.std() * draw.uniform(0.5, 0.8)
    return DriveReferences(current * min(1.0, 22.0 / _highest_speed(current)))


def free_velocity(draw: Generator) -> DriveReferences:
    """Slow turns in both directions, steps of speed, sweeps."""
    first = float(draw.choice([-1.0, 1.0]))
    slow = [first * draw.uniform(0.25, 0.7), -first * draw.uniform(0.2, 0.6)]
    parts = [_hold_levels([speed], draw.uniform(8.0, 12.0), 0.0) for speed in slow]
    magnitudes = draw.permutation(np.exp(np.linspace(math.log(draw.uniform(1.5, 3.0)), math.log(28.0), 6)))
    steps = magnitudes * draw.uniform(0.85, 1.05, 6) * first * np.array([1, -1, 1, -1, 1, -1])
    parts.append(_hold_levels(steps, draw.uniform(2.0, 2.8), draw.choice([0.0, 0.05, 0.3])))
    period, turns = draw.uniform(9.0, 14.0), 2
    phase = np.arange(round(turns * period / TICK)) * TICK / period
    sweep = np.sin(2 * np.pi * phase) if draw.random() < 0.4 else 2 / np.pi * np.arcsin(np.sin(2 * np.pi * phase))
    parts.append(draw.uniform(27.0, 31.0) * sweep * float(draw.choice([-1.0, 1.0])))
    velocity = np.concatenate(parts)
    gain = draw.uniform(110.0, 220.0)
    return DriveReferences(np.zeros(len(velocity)), velocity, "test", gain, gain * draw.uniform(3.0, 8.0))


def heating(draw: Generator, strong: bool) -> Array:
    """Current through two leads, at one or two levels, then cooling; one row a second."""
    level = draw.uniform(7.4, 9.0) if strong else draw.uniform(5.0, 6.6)
    warm, cool = int(draw.uniform(3400, 4600)), int(draw.uniform(3400, 4600))
    current = np.full(warm, level)
    if draw.random() < 0.3:
        current[int(warm * draw.uniform(0.4, 0.7)) :] *= draw.uniform(0.7, 0.85)
    return np.concatenate([current, np.zeros(cool)])


PROGRAM_DRAWS = {
    "locked_staircase": locked_staircase,
    "coupled_grid": coupled_grid,
    "free_multisine": free_multisine,
    "free_velocity": free_velocity,
}


def _hold_levels(levels: "list[float] | Array", dwell: float, ramp: float) -> Array:
    """Hold each level, after a linear ramp from the level before; the first ramp starts from zero."""
    held, climb = round(dwell / TICK), round(ramp / TICK)
    parts, before = [], 0.0
    for level in levels:
        parts.append(before + (level - before) * np.arange(1, climb + 1) / max(climb, 1))
        parts.append(np.full(held, level))
        before = float(level)
    return np.concatenate(parts)


def _limit_slew(signal: Array, rate: float) -> Array:
    limited, highest_step = np.empty_like(signal), rate * TICK
    value = 0.0
    for k, target in enumerate(signal.tolist()):
        value += min(max(target - value, -highest_step), highest_step)
        limited[k] = value
    return limited


def _sum_sines(draw: Generator, duration: float, low: float, high: float, lines: int) -> Array:
    """Sum sines at frequencies spread evenly on a logarithmic scale, multiples of 1 / duration, with random phases."""
    time = np.arange(round(duration / TICK)) * TICK
    frequencies = np.exp(np.linspace(math.log(low), math.log(high), lines) + draw.uniform(-0.05, 0.05, lines))
    cycles = np.unique(np.maximum(np.rint(frequencies * duration), 1.0))
    total = np.zeros(len(time))
    for count in cycles:
        total += np.sin(2 * np.pi * count / duration * time + draw.uniform(0, 2 * np.pi))
    return total


def _highest_speed(current: Array) -> float:
    """Highest speed without Coulomb friction [rad/s], times 0.65 because friction takes about a third of it."""
    rate = 2j * np.pi * np.fft.rfftfreq(len(current), TICK)
    response = TORQUE_CONSTANT / (DAMPING + INERTIA * rate)
    speed = np.fft.irfft(np.fft.rfft(current) * response, len(current))
    return float(np.abs(speed).max()) * 0.65
