"""Runs of a free rotor that turns at given speeds, every part of its drag known."""

import numpy as np

SPEEDS = (2.0, 5.0, 10.0, 20.0, 35.0)
F, B, C, KT = 0.208, 0.0238, 4e-4, 0.49


def turned(bench, *, f=F, b=B, c=C, zero_A=0.0, gain=1.0, speeds=SPEEDS, signs=(1, -1), trials=2, scatter=0.0,  # noqa: N803
           **how):  # fmt: skip
    """A run by q-axis current over the drag; `scatter` [N*m] is of single holds, `gain` of the current's reading."""
    velocity = np.array([sign * speed for _ in range(trials) for sign in signs for speed in speeds])
    torque = f * np.sign(velocity) + b * velocity + c * velocity * np.abs(velocity)
    current = gain * (torque + bench.rng.normal(0.0, scatter, len(velocity))) / KT + zero_A
    how = {"mechanical": "free", "key": "velocity_rad_s", "rate_Hz": 10} | how
    levels = {"velocity": velocity, "q_axis_current": current}
    return bench.run("no-load-loss", [(value, "") for value in velocity], levels, **how)
