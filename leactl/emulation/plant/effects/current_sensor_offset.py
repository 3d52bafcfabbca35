"""A current sensor whose zero is wrong: the drive regulates a current that differs from the command."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantCurrentSensorOffset(PlantEffect):
    """Reading = current + offset."""

    offset: float = bounded(0.0, -10.0, 10.0)  # A, q axis

    def sense_current(self, current: float) -> float:
        """Add the offset to the current."""
        return current + self.offset
