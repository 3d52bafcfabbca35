"""Runs of an unpowered actuator that another machine turns: breakaway, drag and cogging are known."""

import math

import numpy as np

F, B, C, COG, ORDER, J = 0.208, 0.0238, 1e-4, 0.03, 82, 0.0024
RATE, TURN_S, HOLD_S, BREAK_S, W = 200, 13.5, 1.5, 3.0, 0.5
SPEEDS = (2.0, 5.0, 10.0, 20.0, 30.0)
COUNT = 2 * math.pi / 40000


class Record:
    """Columns that grow part by part; the test actuator's angle goes on from part to part."""

    def __init__(self):
        self.parts, self.steps, self.count, self.angle = [], [], 0, 0.3

    def add(self, name, speed, torque, settle=0.0, **told):
        """One step: speed [rad/s] at every sample, and torque onto the shaft by angle and speed."""
        angle = self.angle + np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) / RATE
        self.parts.append((speed, angle, torque(angle)))
        start, self.count = self.count, self.count + len(speed)
        self.steps.append((name, start / RATE, self.count / RATE, settle, {"role": "load"} | told))
        self.angle = angle[-1] + speed[-1] / RATE


def driven(bench, *, f=F, b=B, c=C, cogging=COG, breakaway=0.25, zero=0.02, gain=1.0, noise=0.004, signs=(1, -1),
           trials=2, ripple=0.05, enabled=0.0, turn_s=TURN_S, lets_go=True, speeds=SPEEDS, edit=None, inertia=J,
           breakaway_scatter=0.0, scatter=0.0, **how):  # fmt: skip
    """A run: for each trial and sign a breakaway, a slow turn whose speed ripples with the cogging, and levels.

    `breakaway_scatter` and `scatter` [N*m] move single breakaways and the friction of single holds; `gain` is that of
    the torque's reading, `inertia` what the run's model says.
    """
    record = Record()
    for sign in [sign for _ in range(trials) for sign in signs]:
        time = np.arange(round(BREAK_S * RATE)) / RATE
        moved = 2.5 if lets_go else BREAK_S
        speed = np.where(time > moved, 12.5 * sign * (time - moved) ** 2, 0.0)
        own = breakaway + bench.rng.normal(0.0, breakaway_scatter)
        wound = np.minimum(0.1 * np.maximum(time - moved + own / 0.1, 0.0), own)
        record.add("breakaway", speed, lambda _angle, wound=wound, sign=sign: -sign * wound)

        time = np.arange(round(turn_s * RATE)) / RATE
        angle = record.angle + sign * W * time
        swing = -sign * ripple * np.cos(ORDER * angle)  # the cogging speeds the rotor up, whichever way it turns
        growth = ripple * ORDER * W * np.sin(ORDER * angle)

        def slow(angle, sign=sign, swing=swing, growth=growth):
            return cogging * np.sin(ORDER * angle) - f * sign - b * (sign * W + swing) - J * growth

        record.add("turn", sign * W + swing, slow, 0.0, velocity_rad_s=sign * W)
        for level in speeds:
            drag = -sign * (f + bench.rng.normal(0.0, scatter) + b * level + c * level**2)
            speed = np.full(round(HOLD_S * RATE), sign * level)
            record.add(
                "hold", speed, lambda angle, drag=drag: np.full_like(angle, drag), 0.5, velocity_rad_s=sign * level
            )
    speed, angle, torque = (np.concatenate(column) for column in zip(*record.parts, strict=True))
    columns = {
        "velocity": speed + bench.rng.normal(0.0, 0.002, len(speed)),
        "angle": np.round(angle / COUNT) * COUNT,
        "torque": gain * torque + zero + bench.rng.normal(0.0, noise, len(speed)),
        "drive_enabled": np.full(len(speed), enabled),
    }
    if edit is not None:
        edit(columns)
    time = np.arange(len(speed)) / RATE
    return bench.write("back-drive", time, columns, record.steps, model=f"rotor_inertia: {inertia}\n", **how)
