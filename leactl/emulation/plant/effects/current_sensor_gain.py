"""A current sensor whose gain is wrong: the drive then regulates the wrong current."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import PlantEffect
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantCurrentSensorGain(PlantEffect):
    """Reading = gain x current."""

    gain: float = bounded(1.0, 0.1, 10.0)

    def sense_current(self, current: float) -> float:
        """Multiply the current by the gain."""
        return self.gain * current
