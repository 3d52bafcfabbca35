"""A cable that pulls the shaft back to a rest angle."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded

SLIP_ANGLE = 25.0  # rad from rest (four turns), at which slip halves the torque of Hooke's law


@dataclass(frozen=True)
class PlantPositionSpring(PlantEffect):
    """Torque = -stiffness x / (1 + |x| / a few turns), where x is the angle from the rest angle."""

    adds_torque: ClassVar[bool] = True
    stiffness: float = bounded(0.0, 0.0, 1000.0)  # N*m/rad
    rest_angle: float = bounded(0.0, -1e6, 1e6)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Follow Hooke's law near the rest angle; further away the cable slips on its drum."""
        deflection = angle - self.rest_angle
        return -self.stiffness * deflection / (1.0 + np.abs(deflection) / SLIP_ANGLE)
