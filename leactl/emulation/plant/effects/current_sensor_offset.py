"""A current sensor whose zero is off: the drive regulates a current away from the command."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantCurrentSensorOffset(PlantEffect):
    """Reading = current + offset."""

    offset: float = bounded(0.0, -10.0, 10.0)  # A, q axis

    def sense_current(self, current: float) -> float:
        """Shift."""
        return current + self.offset
