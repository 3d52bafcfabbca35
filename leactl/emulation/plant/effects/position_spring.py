"""A cable that pulls a shaft back."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded

SLIP_ANGLE = 25.0  # rad from rest (four turns), at which slip halves the torque of Hooke's law


@dataclass(frozen=True)
class PlantPositionSpring(PlantEffect):
    """Torque = -stiffness x / (1 + |x| / a few turns), x being the angle from the rest."""

    adds_torque: ClassVar[bool] = True
    stiffness: float = bounded(0.0, 0.0, 1000.0)  # N*m/rad
    rest_angle: float = bounded(0.0, -1e6, 1e6)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Hooke's law near the rest; further on the cable slips on its drum."""
        away = angle - self.rest_angle
        return -self.stiffness * away / (1.0 + np.abs(away) / SLIP_ANGLE)
