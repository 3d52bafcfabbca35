"""An ambient that moves away from where it is logged."""

import math
from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantAmbientDrift(PlantEffect):
    """Half a cosine over two hours, `change` at its end."""

    change: float = bounded(0.0, -50.0, 50.0)  # K

    def ambient_error(self, time: float) -> Value:
        """A door stays open, slowly felt."""
        return self.change * 0.5 * (1.0 - math.cos(math.pi * min(time / 7200.0, 1.0)))
