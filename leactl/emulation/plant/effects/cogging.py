"""Torque that depends on the rotor's angle alone: teeth against magnets."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantCogging(PlantEffect):
    """Torque = amplitude [sin(order angle + phase) + a sixth of it at twice the order]."""

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m
    order: float = bounded(82.0, 1.0, 10000.0)  # periods per revolution
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Sum the fundamental and the second harmonic; flat-topped teeth give both."""
        turn = self.order * angle + self.phase
        sine = np.sin(turn)
        return self.amplitude * sine * (1.0 + np.cos(turn) / 3.0)
