"""Runs of a machine whose voltage equation is solved by itself, driving against another that holds the speed."""

import math

import numpy as np
from scipy.optimize import brentq

R, KT, L, POLES, F, B, J, BUS, ASKED = 0.264, 0.49, 128e-6, 41, 0.208, 0.0238, 0.0024, 29.6, 28.0
ALPHA = 0.004  # 1/K, of the winding
SPEEDS = (5.0, 10.0, 15.0, 20.0, 24.0, 28.0, 30.0, 32.0, 34.0, 36.0)


def short_of(speed, current, bus=BUS, kelvin=0.0):
    """What the voltage at the leads is above what the bus gives [V]; `kelvin` is how far the winding has warmed."""
    hot = R * (1.0 + ALPHA * kelvin)
    return math.hypot(hot * current + KT * speed, POLES * speed * L * current) - bus / math.sqrt(2)


def current_at(speed, bus=BUS, warmed=lambda _current: 0.0):
    """What the voltage leaves [A], at most what is asked for; `warmed` tells how far the winding is [K] by current."""

    def over(current):
        return short_of(speed, current, bus, warmed(current))

    return ASKED if over(ASKED) < 0 else brentq(over, 0.0, ASKED)


def model_of(inertia=J, inductance=L):
    return f"rotor_inertia: {inertia}\npole_pairs: {POLES}\nphase_inductance: {inductance}\nback_emf_constant: {KT}\n"


def true_corner(kelvin=0.0):
    return brentq(lambda speed: short_of(speed, ASKED, kelvin=kelvin), 1, 60)


def driven(bench, *, speeds=SPEEDS, trials=3, scatter=0.0, bus=BUS, sag=0.0, asked=ASKED, slowing=0.0, zero=0.0,
           gain=1.0, warmed=(), edit=None, model="", **how):  # fmt: skip
    """A run; `scatter` [N*m] is of single holds, `slowing` [rad/s^2] within each, `zero` and `gain` the sensor's.

    `warmed` has for each trial how far the winding is at rest [K], and how far a hold at 28 A takes it besides.
    """
    holds = [(asked, "") for _ in range(trials) for _ in speeds]
    speed = np.array([value for _ in range(trials) for value in speeds]) + bench.rng.normal(0.0, 1e-3, len(holds))
    heat = [warmed[k // len(speeds)] if warmed else (0.0, 0.0) for k in range(len(holds))]
    current = np.array(
        [
            current_at(abs(value), bus, lambda amperes, own=own: own[0] + own[1] * (amperes / ASKED) ** 2)
            for value, own in zip(speed, heat, strict=True)
        ]
    )
    current = current * asked / ASKED
    torque = KT * current - F - B * np.abs(speed) + bench.rng.normal(0.0, scatter, len(holds)) + J * slowing
    columns = {
        "torque": gain * torque + zero,
        "velocity": speed,
        "q_axis_current": current,
        "bus_voltage": bus - sag * np.abs(torque),
    }

    def slow_down(time, columns):
        into = (time - how.get("before_s", 0.0)) % hold_s
        columns["velocity"] -= slowing * (into - 0.5 * (settle_s + hold_s - 1.0 / how["rate_Hz"]))
        if edit is not None:
            edit(time, columns)

    hold_s, settle_s = how.get("hold_s", 2.5), how.get("settle_s", 0.5)
    how = {"rate_Hz": 10, "model": model or model_of()} | how
    return bench.run("torque-speed-envelope", holds, columns, edit=slow_down, **how)
