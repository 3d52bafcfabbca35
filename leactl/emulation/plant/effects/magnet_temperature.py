"""Magnets that weaken as they warm; they have the housing's temperature."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantMagnetTemperature(PlantEffect):
    """Torque and back-EMF constant x exp(-coefficient (housing - 25 degC))."""

    coefficient: float = bounded(0.0, 0.0, 0.05)  # 1/K

    def magnet_share(self, now: Now) -> Value:
        """Scale torque constant and back-EMF constant by one factor."""
        return np.exp(-self.coefficient * (now.housing - 25.0))
