"""Convection that grows with the rotor's speed."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantForcedConvection(PlantEffect):
    """Conductance x (1 + coefficient |speed| / 0.8)^0.8, as a turbulent boundary layer gives."""

    coefficient: float = bounded(0.0, 0.0, 10.0)  # s/rad

    def housing_conductance(self, rise: Value, speed: Value) -> Value:
        """Increase the conductance with speed."""
        return (1.0 + 1.25 * self.coefficient * np.abs(speed)) ** 0.8
