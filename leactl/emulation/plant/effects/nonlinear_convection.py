"""Convection that grows with the housing's temperature."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantNonlinearConvection(PlantEffect):
    """Conductance x sqrt(1 + 2 coefficient rise): relative growth `coefficient` per kelvin at first, less later."""

    coefficient: float = bounded(0.0, 0.0, 1.0)  # 1/K

    def housing_conductance(self, rise: Value, speed: Value) -> Value:
        """Increase the conductance with the magnitude of the rise."""
        return np.sqrt(1.0 + 2.0 * self.coefficient * np.abs(rise))
