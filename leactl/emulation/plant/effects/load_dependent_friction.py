"""Friction that grows with the torque transmitted, as in loaded bearings and teeth."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantLoadDependentFriction(PlantEffect):
    """Level = Coulomb + coefficient x torque, rounded below the bearings' own preload."""

    coefficient: float = bounded(0.0, 0.0, 2.0)

    def coulomb(self, level: Value, now: Now) -> Value:
        """Add the load's share, less the 0.15 N*m of the bearings' preload."""
        return level + self.coefficient * (np.hypot(now.shaft_torque, 0.15) - 0.15)
