"""Friction and iron loss that heat the machine."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantRotationalHeat(PlantEffect):
    """Heat into the housing = fraction x (b w^2 + f |w|)."""

    fraction: float = bounded(0.0, 0.0, 10.0)

    def housing_heat(self, friction_power: Value) -> Value:
        """Return a fraction of the friction power."""
        return self.fraction * friction_power
