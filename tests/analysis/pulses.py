"""Runs of pulses of current on a locked shaft, saturation and sticking known."""

import numpy as np

LEVELS = (4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 28.0)
KT = 0.49


def kept(current, loss):
    """Share of the torque that iron of a knee leaves, `loss` being missing at 28 A."""
    return 1.0 / np.sqrt(1.0 + ((1.0 - loss) ** -2 - 1.0) * (current / 28.0) ** 2)


def pulsed(bench, *, loss=0.1, sticking=0.1, ringing=0.0, offset=0.02, levels=LEVELS, signs=(1, -1), trials=2,
           scatter=0.0, gains=(1.0, 1.0), sides=("rising", "falling"), **how):  # fmt: skip
    """A run; `gains` are those of the readings of torque and of current, `scatter` [N*m] is of single holds.

    `ringing` [N*m] is what of the sticking is the same on both sides of a level, against the torque.
    """
    holds = [(sign * level, side) for _ in range(trials) for sign in signs for level in levels for side in sides]
    current = np.array([level for level, _ in holds])
    side = np.array([{"rising": 1, "falling": -1}.get(side, 0) for _, side in holds])
    torque = KT * current * kept(current, loss) - sticking * side - ringing * np.sign(current) + offset
    torque = gains[0] * (torque + bench.rng.normal(0.0, scatter, len(holds)))
    how = {"mechanical": "locked", "rate_Hz": 10} | how
    return bench.run("torque-pulses", holds, {"q_axis_current": gains[1] * current, "torque": torque}, **how)
