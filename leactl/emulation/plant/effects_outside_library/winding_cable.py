"""A cable that the rotor winds up: a torque that depends on the unwrapped angle and does not repeat every turn."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from leactl.emulation.plant.effects.contract import Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class WindingCable(Unlisted):
    """Torque = -amplitude x a sum of three sines of the angle with incommensurate periods."""

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.05, 0.0, 10.0)  # N*m
    wave: float = bounded(9.0, 0.1, 1000.0)  # rad, the longest
    phase: float = bounded(0.0, 0.0, 7.0)  # rad

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw an amplitude of 0.012 to 0.25 N*m over two to five turns."""
        return cls(
            amplitude=between(0.012, 0.25, size),
            wave=float(draw.uniform(13.0, 31.0)),
            phase=float(draw.uniform(0.0, 6.28)),
        )

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Torque at the unwrapped angle."""
        turn = 2.0 * np.pi * angle / self.wave + self.phase
        waves = np.sin(turn) + 0.7 * np.sin(2.236 * turn + 1.3) + 0.5 * np.sin(3.873 * turn + 0.4)
        return -0.7 * self.amplitude * waves
