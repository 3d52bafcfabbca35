"""A drive whose current follows its reference after a delay, as from a fieldbus or a slow cycle."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import Path, PlantEffect
from leactl.emulation.plant.effects.memory import Delay
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTransportDelay(PlantEffect):
    """The current loop gets the reference of `delay` earlier."""

    delay: float = bounded(0.0, 0.0, 0.5)  # s

    def reference_path(self, lanes: int, step_s: float) -> Path:
        """Delay the reference."""
        return Delay(self.delay, lanes, step_s)
