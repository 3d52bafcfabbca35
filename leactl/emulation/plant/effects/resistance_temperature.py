"""Copper whose resistance rises with temperature, where the nominal model has no coefficient."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantResistanceTemperature(PlantEffect):
    """Resistance x (1 + coefficient (winding - 25 degC))."""

    coefficient: float = bounded(0.0, 0.0, 0.02)  # 1/K

    def resistance_share(self, winding: Value, time: float) -> Value:
        """Increase linearly, as copper does within 1 % up to 150 degC."""
        return 1.0 + self.coefficient * (winding - 25.0)
