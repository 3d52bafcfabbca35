"""A camera set to the wrong emissivity."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantEmissivityBias(PlantEffect):
    """Reading = ambient + fraction x rise."""

    fraction: float = bounded(1.0, 0.01, 10.0)

    def camera(self, temperature: Value, ambient: Value) -> Value:
        """Scale the rise above ambient by the fraction."""
        return ambient + self.fraction * (temperature - ambient)
