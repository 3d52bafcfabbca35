"""A torque sensor whose zero is wrong."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTorqueSensorOffset(PlantEffect):
    """Reading = torque + offset."""

    offset: float = bounded(0.0, -100.0, 100.0)  # N*m

    def sense_torque(self, torque: float) -> float:
        """Add the offset to the torque."""
        return torque + self.offset
