"""Friction that changes as the machine warms: grease thins, or seals tighten."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantFrictionTemperature(PlantEffect):
    """Viscous damping and Coulomb friction x exp(coefficient (housing - 25 degC)), after Arrhenius."""

    coefficient: float = bounded(0.0, -0.1, 0.1)  # 1/K

    def friction_share(self, now: Now) -> Value:
        """Scale viscous damping and Coulomb friction by one factor."""
        return np.exp(np.clip(self.coefficient * (now.housing - 25.0), -2.0, 2.0))
