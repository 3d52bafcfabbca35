"""Gravity on an eccentric mass."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantUnbalance(PlantEffect):
    """Torque = amplitude sin(angle + phase)."""

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Gravity torque of an eccentric mass at an angle."""
        return self.amplitude * np.sin(angle + self.phase)
