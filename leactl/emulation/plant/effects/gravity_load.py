"""Gravity on an arm."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantGravityLoad(PlantEffect):
    """A weight on an arm that is `phase` above level at angle zero; the torque falls as the arm rises."""

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m, held out level
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Pull the arm down, in whichever direction it moves; the lever is the horizontal reach of the arm."""
        reach = np.cos(angle) * np.cos(self.phase) - np.sin(angle) * np.sin(self.phase)
        return -self.amplitude * reach
