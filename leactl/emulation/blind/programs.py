"""References of the drives in the runs of a case; their levels, dwells, phases and directions are drawn at random.

Kinds of run: `locked_staircase`, `coupled_grid`, `free_multisine`, `free_velocity`, and the currents of `heating`.
"""

import math

import numpy as np

from leactl.emulation.plant.stepped.lanes import Array
from leactl.emulation.plant.stepped.plant import TICK
from leactl.emulation.plant.stepped.simulation import DriveReferences

MOVING_KINDS = ("locked_staircase", "coupled_grid", "free_multisine", "free_velocity")
RUN_KINDS = (*MOVING_KINDS, "heating")
SETUPS = {
    "locked_staircase": "locked",
    "coupled_grid": "coupled",
    "free_multisine": "free",
    "free_velocity": "free",
    "heating": "heated",
}
TORQUE_CONSTANT, DAMPING, INERTIA = 0.49, 0.0238, 0.0024  # N*m/A, N*m*s/rad, kg*m^2: nominal, to choose amplitudes
Generator = np.random.Generator


def locked_staircase(draw: Generator) -> DriveReferences:
    """Draw rising and falling current levels of both signs, perhaps with a minor loop, then a fast multisine."""
    level_count = int(draw.integers(4, 7))
    peak, dwell, ramp = draw.uniform(18.0, 24.5), draw.uniform(0.8, 1.4), draw.uniform(0.06, 0.3)
    rising_levels = [peak * (k + 1) / level_count for k in range(level_count)]
    one_sign_levels = [
        *rising_levels,
        *([rising_levels[-2], rising_levels[-1]] if draw.random() < 0.5 else []),
        *rising_levels[-2::-1],
        0.0,
    ]
    first_sign = float(draw.choice([-1.0, 1.0]))
    held_levels = [first_sign * level for level in one_sign_levels] + [-first_sign * level for level in one_sign_levels]
    stairs = _hold_levels(held_levels, dwell, ramp)
    multisine = _sum_sines(draw, draw.uniform(7.0, 11.0), 0.3, draw.uniform(60.0, 150.0), 30)
    multisine *= draw.uniform(1.2, 3.0) / multisine.std()
    bias = draw.uniform(-4.0, 4.0)
    return DriveReferences(
        np.concatenate([stairs, _hold_levels([bias], 0.5, 0.2), np.clip(multisine + bias, -20.0, 20.0)])
    )


def coupled_grid(draw: Generator) -> DriveReferences:
    """Draw speeds of both signs that the load holds, and for each speed currents of both signs of the test drive."""
    magnitudes = np.sort(np.exp(draw.uniform(math.log(2.0), math.log(27.0), int(draw.integers(4, 7)))))
    magnitudes[-1] = max(magnitudes[-1], draw.uniform(18.0, 27.0))
    speeds = draw.permutation(np.concatenate([magnitudes, -magnitudes]))
    currents_per_speed = int(draw.integers(4, 7))
    dwell = draw.uniform(40.0, 52.0) / (len(speeds) * currents_per_speed)
    currents = []
    for speed in speeds:
        # the ceiling of 20.9 V less back-EMF and a margin for warm copper
        highest_current = min(draw.uniform(16.0, 21.0), (19.0 - TORQUE_CONSTANT * abs(speed)) / 0.36)
        currents_at_speed = np.linspace(-highest_current, highest_current, currents_per_speed) + draw.uniform(
            -0.8, 0.8, currents_per_speed
        )
        currents += list(draw.permutation(currents_at_speed))
    ramp = draw.uniform(0.04, 0.15)
    current = _hold_levels(currents, dwell - ramp, ramp)
    velocity = _hold_levels(np.repeat(speeds, currents_per_speed), dwell - ramp, ramp)
    limited_velocity = _limit_slew(velocity, draw.uniform(60.0, 250.0))
    gain = draw.uniform(110.0, 190.0)
    integral = gain * draw.uniform(8.0, 15.0)
    return DriveReferences(current, limited_velocity, "load", gain, integral, feedforward=draw.uniform(0.8, 0.97))


def free_multisine(draw: Generator) -> DriveReferences:
    """Draw a current of many sines that turns the rotor back and forth through standstill."""
    duration = draw.uniform(36.0, 44.0)
    current = _sum_sines(draw, duration, draw.uniform(0.03, 0.06), draw.uniform(30.0, 70.0), int(draw.integers(20, 32)))
    slow_current = _sum_sines(draw, duration, 0.1, 0.6, 4)
    current = current / current.std() * draw.uniform(0.55, 0.8) + slow_current / slow_current.std() * draw.uniform(
        0.5, 0.8
    )
    return DriveReferences(current * min(1.0, 22.0 / _highest_speed(current)))


def free_velocity(draw: Generator) -> DriveReferences:
    """Draw slow turns in both directions, then steps of speed, then sweeps of sine or triangle shape."""
    first_sign = float(draw.choice([-1.0, 1.0]))
    slow_speeds = [first_sign * draw.uniform(0.25, 0.7), -first_sign * draw.uniform(0.2, 0.6)]
    velocity_parts = [_hold_levels([speed], draw.uniform(8.0, 12.0), 0.0) for speed in slow_speeds]
    magnitudes = draw.permutation(np.exp(np.linspace(math.log(draw.uniform(1.5, 3.0)), math.log(28.0), 6)))
    speed_steps = magnitudes * draw.uniform(0.85, 1.05, 6) * first_sign * np.array([1, -1, 1, -1, 1, -1])
    velocity_parts.append(_hold_levels(speed_steps, draw.uniform(2.0, 2.8), draw.choice([0.0, 0.05, 0.3])))
    period, period_count = draw.uniform(9.0, 14.0), 2
    phase = np.arange(round(period_count * period / TICK)) * TICK / period
    sweep = np.sin(2 * np.pi * phase) if draw.random() < 0.4 else 2 / np.pi * np.arcsin(np.sin(2 * np.pi * phase))
    velocity_parts.append(draw.uniform(27.0, 31.0) * sweep * float(draw.choice([-1.0, 1.0])))
    velocity = np.concatenate(velocity_parts)
    gain = draw.uniform(110.0, 220.0)
    return DriveReferences(np.zeros(len(velocity)), velocity, "test", gain, gain * draw.uniform(3.0, 8.0))


def heating(draw: Generator, strong: bool) -> Array:
    """Draw a current through two leads [A] at one or two levels, then zero for cooling; one value a second."""
    level = draw.uniform(7.4, 9.0) if strong else draw.uniform(5.0, 6.6)
    heated_seconds, cooling_seconds = int(draw.uniform(3400, 4600)), int(draw.uniform(3400, 4600))
    current = np.full(heated_seconds, level)
    if draw.random() < 0.3:
        current[int(heated_seconds * draw.uniform(0.4, 0.7)) :] *= draw.uniform(0.7, 0.85)
    return np.concatenate([current, np.zeros(cooling_seconds)])


PROGRAM_DRAWS = {
    "locked_staircase": locked_staircase,
    "coupled_grid": coupled_grid,
    "free_multisine": free_multisine,
    "free_velocity": free_velocity,
}


def _hold_levels(levels: "list[float] | Array", dwell: float, ramp: float) -> Array:
    """Return a signal that holds each level for `dwell` [s] after a ramp [s] from the previous level, at first zero."""
    dwell_ticks, ramp_ticks = round(dwell / TICK), round(ramp / TICK)
    parts, previous_level = [], 0.0
    for level in levels:
        parts.append(previous_level + (level - previous_level) * np.arange(1, ramp_ticks + 1) / max(ramp_ticks, 1))
        parts.append(np.full(dwell_ticks, level))
        previous_level = float(level)
    return np.concatenate(parts)


def _limit_slew(signal: Array, rate: float) -> Array:
    """Return a signal that follows `signal` by at most `rate` a second."""
    limited_signal, highest_step = np.empty_like(signal), rate * TICK
    value = 0.0
    for k, target in enumerate(signal.tolist()):
        value += min(max(target - value, -highest_step), highest_step)
        limited_signal[k] = value
    return limited_signal


def _sum_sines(
    draw: Generator, duration: float, lowest_frequency: float, highest_frequency: float, sine_count: int
) -> Array:
    """Return a sum of sines of unit amplitude with random phases.

    Their frequencies [Hz] are spread evenly on a logarithmic scale, and rounded to multiples of 1 / duration.
    """
    time = np.arange(round(duration / TICK)) * TICK
    frequencies = np.exp(
        np.linspace(math.log(lowest_frequency), math.log(highest_frequency), sine_count)
        + draw.uniform(-0.05, 0.05, sine_count)
    )
    cycles = np.unique(np.maximum(np.rint(frequencies * duration), 1.0))
    signal = np.zeros(len(time))
    for cycle_count in cycles:
        signal += np.sin(2 * np.pi * cycle_count / duration * time + draw.uniform(0, 2 * np.pi))
    return signal


def _highest_speed(current: Array) -> float:
    """Return the highest speed [rad/s]: that without Coulomb friction x 0.65, as friction takes about a third."""
    complex_frequency = 2j * np.pi * np.fft.rfftfreq(len(current), TICK)
    response = TORQUE_CONSTANT / (DAMPING + INERTIA * complex_frequency)
    speed = np.fft.irfft(np.fft.rfft(current) * response, len(current))
    return float(np.abs(speed).max()) * 0.65
