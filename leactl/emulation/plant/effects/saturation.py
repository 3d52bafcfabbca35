"""Iron that saturates: torque grows less than in proportion to the current."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantSaturation(PlantEffect):
    """Torque constant / sqrt(1 + (i / knee)^2), with the knee at which the share `loss` is lost at 25 A."""

    loss: float = bounded(0.0, 0.0, 0.9)

    def torque_share(self, now: Now) -> Value:
        """Reduce the torque constant alike for both signs of the current."""
        steepness = ((1.0 - self.loss) ** -2 - 1.0) / 625.0
        return 1.0 / np.sqrt(1.0 + steepness * now.current * now.current)
