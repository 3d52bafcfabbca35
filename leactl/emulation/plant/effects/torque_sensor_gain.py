"""A torque sensor whose calibration is wrong by a factor."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTorqueSensorGain(PlantEffect):
    """Reading = gain x torque."""

    gain: float = bounded(1.0, 0.1, 10.0)

    def sense_torque(self, torque: float) -> float:
        """Multiply the torque by the gain."""
        return self.gain * torque
