"""A torque stream that is late relative to the drive's streams."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import Path, PlantEffect
from leactl.emulation.plant.effects.memory import Delay
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTimeSkew(PlantEffect):
    """The torque reading shows the torque of `delay` earlier."""

    delay: float = bounded(0.0, 0.0, 0.5)  # s

    def torque_path(self, lanes: int, step_s: float) -> Path:
        """Delay the torque reading."""
        return Delay(self.delay, lanes, step_s)
