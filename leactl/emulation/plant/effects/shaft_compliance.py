"""A shaft or sensor much softer than the model's."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantShaftCompliance(PlantEffect):
    """Shaft stiffness that replaces the bench's."""

    stiffness: float = bounded(6000.0, 1.0, 1e7)

    def shaft_stiffness(self, nominal: Value) -> Value:
        """Return this stiffness in place of the nominal one."""
        return self.stiffness + 0.0 * nominal
