"""Torque that depends on the rotor's angle alone: teeth against magnets."""

import math
from dataclasses import dataclass
from typing import ClassVar

from leactl.emulation.effects.contract import Effect
from leactl.emulation.parameters import bounded


@dataclass(frozen=True)
class Cogging(Effect):
    """Torque = amplitude sin(order angle + phase)."""

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m
    order: float = bounded(82.0, 1.0, 10000.0)  # periods per revolution
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque(self, angle: float, velocity: float) -> float:
        """Sine over the angle."""
        return self.amplitude * math.sin(self.order * angle + self.phase)
