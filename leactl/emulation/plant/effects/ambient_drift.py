"""Ambient temperature that departs from the logged one."""

import math
from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantAmbientDrift(PlantEffect):
    """Half a cosine over two hours, `change` at its end."""

    change: float = bounded(0.0, -50.0, 50.0)  # K

    def ambient_error(self, time: float) -> Value:
        """Follow half a cosine: slow at first, as when a door stays open."""
        return self.change * 0.5 * (1.0 - math.cos(math.pi * min(time / 7200.0, 1.0)))
