"""A shaft or sensor much softer than the model's."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantShaftCompliance(PlantEffect):
    """Stiffness in place of the bench's."""

    stiffness: float = bounded(6000.0, 1.0, 1e7)

    def shaft_stiffness(self, nominal: Value) -> Value:
        """Replace it."""
        return self.stiffness + 0.0 * nominal
