"""A fixture that takes up heat from the housing."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantThirdThermalNode(PlantEffect):
    """A heat capacity coupled to the housing through a thermal resistance."""

    capacitance: float = bounded(500.0, 1e-3, 1e6)  # J/K
    resistance: float = bounded(2.0, 1e-3, 1e6)  # K/W

    def fixture(self) -> tuple[Value, Value]:
        """Return capacity [J/K] and thermal resistance [K/W]."""
        return self.capacitance, self.resistance
