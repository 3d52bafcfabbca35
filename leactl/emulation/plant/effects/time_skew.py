"""A torque stream that is late against the drive's."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import Path, PlantEffect
from leactl.emulation.plant.effects.memory import Delay
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTimeSkew(PlantEffect):
    """The torque as it was `delay` ago."""

    delay: float = bounded(0.0, 0.0, 0.5)  # s

    def torque_path(self, lanes: int, step_s: float) -> Path:
        """Keep the torque of the last steps."""
        return Delay(self.delay, lanes, step_s)
