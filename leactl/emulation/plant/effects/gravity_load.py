"""Gravity on an arm."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantGravityLoad(PlantEffect):
    """A weight on a lever that stands `phase` above level at angle zero: the further it rises, the less it pulls."""

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m, held out level
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Pulls down whatever the way that the arm moves: the reach is what a point on the unit circle has across."""
        across = np.cos(angle) * np.cos(self.phase) - np.sin(angle) * np.sin(self.phase)
        return -self.amplitude * across
