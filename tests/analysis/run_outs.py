"""Runs of a free rotor whose drive lets go at a steady speed; an ODE solver makes the run-outs."""

import numpy as np
from scipy.integrate import solve_ivp

J, F, B, C, KT, SPEED = 0.0024, 0.208, 0.0238, 2e-4, 0.49, 30.0
HELD_S, COAST_S, RATE = 1.0, 0.4, 500


def run_out(time, j, f, b, c, speed):
    """Speed after the drive let go, at rest once it stands."""

    def slow_down(_time, w):
        return -(f + b * w + c * w * w) / j

    def stands(_time, w):
        return w[0]

    stands.terminal = True
    result = solve_ivp(slow_down, (0.0, time[-1]), [speed], dense_output=True, rtol=1e-10, atol=1e-12, events=stands)
    return np.where(time <= result.t[-1], result.sol(np.minimum(time, result.t[-1]))[0], 0.0)


def coasting(bench, *, j=J, f=F, b=B, c=C, signs=(1, -1), trials=3, zero_A=0.0, gain=1.0, scatter=0.0, noise=0.0,  # noqa: N803
             current_noise=0.0, lag_s=0.0, enabled=0.0, held_s=HELD_S, edit=None, **how):  # fmt: skip
    """A run: a held speed, then a run-out, for each sign and trial; `scatter` moves the friction of single trials.

    `gain` is that of the current's reading; `noise` [rad/s] and `current_noise` [A] are of single readings.
    """
    held = np.arange(round(held_s * RATE)) / RATE
    coast = np.arange(round(COAST_S * RATE)) / RATE
    velocity, current, on, steps, start = [], [], [], [], 0
    for sign in [sign for _ in range(trials) for sign in signs]:
        own = f + bench.rng.normal(0.0, scatter)
        falling = run_out(coast, j, own, b, c, SPEED)
        if lag_s:
            fine = np.arange(0.0, COAST_S, lag_s / 50)
            follow = np.empty_like(fine)
            follow[0] = SPEED
            for k, value in enumerate(run_out(fine, j, own, b, c, SPEED)[:-1]):
                follow[k + 1] = follow[k] + (value - follow[k]) / 50
            falling = np.interp(coast, fine, follow)
        velocity += [sign * np.full(len(held), SPEED), sign * falling]
        drive = sign * gain * (own + b * SPEED + c * SPEED**2) / KT + zero_A
        current += [drive * (1.0 - np.exp(-held / 0.02)), np.full(len(coast), zero_A)]
        on += [np.ones(len(held)), np.full(len(coast), enabled)]
        let_go, stop = start + len(held), start + len(held) + len(coast)
        told = {"velocity_rad_s": sign * SPEED, "role": "test"}
        steps.append(("hold", start / RATE, let_go / RATE, 0.5, told))  # as the stamps have them
        steps.append(("coast", let_go / RATE, stop / RATE, 0.01, {}))
        start = stop
    columns = {"velocity": velocity, "q_axis_current": current, "drive_enabled": on}
    columns = {name: np.concatenate(parts) for name, parts in columns.items()}
    for name, std in (("velocity", noise), ("q_axis_current", current_noise)):
        columns[name] = columns[name] + bench.rng.normal(0.0, std, len(columns[name]))
    if edit is not None:
        edit(columns)
    time = np.arange(len(columns["velocity"])) / RATE
    return bench.write("coast-down", time, columns, steps, **{"mechanical": "free"} | how)
