"""A leg that departs from its MJCF file by what nobody tells: a pendulum on a voltage-driven servo, stepped by Euler.

It shares nothing with MuJoCo, with the callbacks or with leactl's own simulations.
"""

from dataclasses import dataclass

import numpy as np

from leactl.quantities import ChannelSpec
from leactl.runfile.write.run_info import RunInfo
from leactl.runfile.write.writer import RunWriter

COUNT, INTERVAL_S, FINER = 2.0 * np.pi / 4096, 0.005, 40
KINDS = ("steps", "sines", "chirp")
CHANNELS = [
    ChannelSpec("position", "angle", "test", "servo", dtype="f8"),
    ChannelSpec("goal", "angle_reference", "test", "servo", dtype="f8"),
]


@dataclass(frozen=True)
class Leg:
    """The leg of `robots`, off its file by what is usual, and what its file lacks."""

    constant: float = 1.75
    resistance: float = 5.4
    supply: float = 24.0
    gain: float = 45.0
    inertia: float = 0.0154 + 0.6 * 0.15**2
    level: float = 0.6 * 9.81 * 0.15
    damping: float = 0.06
    friction: float = 0.22
    by_load: float = 0.0  # friction by the torque of the motor
    at_rest: float = 0.0  # friction at rest beyond that of sliding, as a share
    fades: float = 0.3  # rad/s, over which that fades
    band: float = 0.0  # rad, of error without an output

    def angles(self, goals):
        """Angles [rad] by an encoder at the stamps of goals, a row a run."""
        angle, speed, rows, step = goals[:, 0] * 0.0, goals[:, 0] * 0.0, [], INTERVAL_S / FINER
        for goal in goals.T:
            rows.append(angle)
            for _ in range(FINER):
                error = goal - np.round(angle / COUNT) * COUNT
                volts = np.clip(self.gain * np.where(np.abs(error) < self.band, 0.0, error), -self.supply, self.supply)
                motor = self.constant * (volts - self.constant * speed) / self.resistance
                rubs = (self.friction + self.by_load * np.abs(motor)) * (
                    1.0 + self.at_rest * np.exp(-((speed / self.fades) ** 2))
                )
                push = motor - self.level * np.sin(angle) - self.damping * speed
                stop = push + self.inertia / step * speed
                slides = speed + step / self.inertia * (push - np.sign(stop) * rubs)
                speed = np.where(np.abs(stop) <= rubs, 0.0, slides)
                angle = angle + step * speed
        return np.round(np.array(rows).T / COUNT) * COUNT


def recorded(folder, leg, seconds, random):
    """Runs of each kind as files, `KIND-a.h5` to fit and `KIND-b.h5` to hold out."""
    time = INTERVAL_S * np.arange(round(seconds / INTERVAL_S))
    names = [f"{kind}-{turn}" for turn in "ab" for kind in KINDS]
    goals = np.stack([goal(name.partition("-")[0], time, random) for name in names])
    for number, (name, asked, angle) in enumerate(zip(names, goals, leg.angles(goals), strict=True)):
        info = RunInfo(
            run_id=f"20261121T1000{number:02d}Z-{name}-0001",
            **dict.fromkeys(("bench", "actuator", "condition", "operator", "software"), "leg"),
            protocol=name.partition("-")[0],
            simulated=False,
            mechanical="free",
            created="2026-11-21T10:00:00Z",
            sources={},
            setup={},
        )
        writer = RunWriter(folder, info, {"loop": CHANNELS})
        writer.append("loop", time, np.stack([angle, asked], axis=1))
        writer.close("complete")
        writer.path.rename(folder / f"{name}.h5")


def goal(kind, time, random):
    """Goals [rad] from zero on: levels, three sines, or a chirp."""
    if kind == "steps":
        levels = random.uniform(-1.4, 1.4, 10)
        return levels[np.minimum((10 * time / time[-1]).astype(int), 9)] * (time > 0.3)
    if kind == "sines":
        phases = random.uniform(0.0, 2.0 * np.pi, 3)
        waves = zip((0.6, 0.35, 0.2), (0.6, 1.7, 4.3), phases, strict=True)
        return sum(high * (np.sin(turn * time + phase) - np.sin(phase)) for high, turn, phase in waves)
    low, high, share = 0.05, random.uniform(1.0, 1.3), time / time[-1]
    return 0.8 * np.sin(2.0 * np.pi * low * time[-1] / np.log(high / low) * ((high / low) ** share - 1.0))
