"""Drag of air or splashed grease."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantQuadraticDrag(PlantEffect):
    """Torque = -coefficient velocity |velocity|."""

    adds_torque: ClassVar[bool] = True
    coefficient: float = bounded(0.0, 0.0, 1.0)  # N*m*s^2/rad^2

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Drag torque that opposes the motion."""
        return -self.coefficient * velocity * np.abs(velocity)
