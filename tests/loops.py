"""The drives' loops worked out by hand: what the emulated bench's parameters make of a step and of a frequency.

Nothing here comes from the emulated bench: the current loop is a closed form, the position servo an integration of its
equations with friction and the servo's speed limit; current and voltage stay below theirs in these steps.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

BAND = 0.02


@dataclass(frozen=True)
class StepFigures:
    """Truth of one step response."""

    rise_time: float  # s
    overshoot: float  # %
    settling_time: float  # s


def current_step(time, bandwidth, lead, lead_time):
    """Answer of the locked current loop to a step of one ampere [A]."""
    fast, slow = 2 * math.pi * bandwidth, 1 / lead_time
    fading = lead * fast / (fast - slow) * (np.exp(-slow * time) - np.exp(-fast * time))
    return 1 - np.exp(-fast * time) + fading


def current_response(frequency, bandwidth, lead, lead_time):
    """Gain and phase of the same loop."""
    s = 2j * math.pi * np.asarray(frequency)
    fast = 2 * math.pi * bandwidth
    return fast / (s + fast) * (1 + lead * s / (s + 1 / lead_time))


def figures(time, response):
    """Figures of a response that ends where it settles, from fine samples."""

    def passes(level, index):
        part = slice(index - 1, index + 1)
        return time[index - 1] + (level - response[part][0]) / np.diff(response[part])[0] * np.diff(time[part])[0]

    rise = passes(0.9, np.argmax(response >= 0.9)) - passes(0.1, np.argmax(response >= 0.1))
    last = int(np.flatnonzero(np.abs(response - 1) > BAND)[-1])
    settled = passes(1 + math.copysign(BAND, response[last] - 1), last + 1)
    return StepFigures(float(rise), float(max(100 * (response.max() - 1), 0)), float(settled))


def current_figures(bandwidth, lead, lead_time):
    """Rise time, overshoot and settling time of the current loop."""
    time = np.arange(0, 0.5, 1e-6)
    return figures(time, current_step(time, bandwidth, lead, lead_time))


def current_bandwidth(bandwidth, lead, lead_time):
    """Where the gain of the current loop falls to -3 dB [Hz]."""
    return brentq(lambda f: abs(current_response(f, bandwidth, lead, lead_time)) - math.sqrt(0.5), 20, 5000)


def position_step(angle, motor, bench, duration=2.0, start=0.0, rest=0.0):
    """Time and angle [rad] of a free servo that rests and is asked for an angle, friction that sticks and all.

    It rests at `start` and is asked for zero for the time `rest` before the jump, from an empty integrator on.
    """
    gain = motor.rotor_inertia / motor.torque_constant
    fast = 2 * math.pi * bench.current_loop_bandwidth

    def slope(_time, state, slip, asked):
        current, velocity, at, integral = state
        speed = np.clip(bench.position_gain * (asked - at), -bench.speed_limit, bench.speed_limit)
        wanted = gain * bench.velocity_gain * (speed - velocity) + integral
        net = motor.torque_constant * current - motor.viscous_damping * velocity - slip * motor.coulomb_friction
        pace = (fast * (wanted - current), gain * bench.velocity_integral * (speed - velocity))
        return [pace[0], net / motor.rotor_inertia if slip else 0.0, velocity, pace[1]]

    def breaks_loose(_time, state, _slip, _asked):
        return motor.coulomb_friction - motor.torque_constant * abs(state[0])

    def rests(_time, state, slip, _asked):
        return slip * state[1]

    breaks_loose.terminal, rests.terminal, rests.direction = True, True, -1
    now, state, slip, fine = -rest, np.array([0.0, 0.0, start, 0.0]), 0, np.arange(0, duration, 5e-5)
    angles = np.full(len(fine), float(start))
    settings = {"method": "LSODA", "rtol": 1e-9, "atol": 1e-11, "max_step": 1e-3, "dense_output": True}
    while now < duration:
        end, asked = (duration, angle) if now >= 0.0 else (0.0, 0.0)
        event = rests if slip else breaks_loose
        part = solve_ivp(slope, (now, end), state, events=event, args=(slip, asked), **settings)
        here = (fine >= now) & (fine <= part.t[-1])
        angles[here] = part.sol(fine[here])[2]
        now, state = part.t[-1], part.y[:, -1]
        if part.status == 0:  # the end of a setpoint, no event
            continue
        pull = motor.torque_constant * state[0]
        free = not slip or abs(pull) > motor.coulomb_friction
        slip = int(math.copysign(1, pull)) if free else 0
        state[1] = slip * 1e-9
    return fine, angles
