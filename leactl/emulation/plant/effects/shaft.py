"""The shaft between two actuators: play and compliance."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantBacklash(PlantEffect):
    """Free play between actuator and shaft.

    The shaft is strained by the part of the twist beyond half the play on either side.
    """

    width: float = bounded(0.0, 0.0, 1.0)  # rad

    def transmitted_twist(self, twist: Value) -> Value:
        """Return the twist [rad] less half the play; zero within the play."""
        half_width = 0.5 * self.width
        return twist - np.minimum(np.maximum(twist, -half_width), half_width)


@dataclass(frozen=True)
class PlantShaftCompliance(PlantEffect):
    """A shaft or torque sensor that is much softer than the model's.

    `stiffness` is that of shaft and torque sensor in series; it replaces the bench's.
    """

    stiffness: float = bounded(6000.0, 1.0, 1e7)  # N*m/rad

    def shaft_stiffness(self, nominal: Value) -> Value:
        """Return this stiffness [N*m/rad] in the shape of the nominal one, which it replaces."""
        return self.stiffness + 0.0 * nominal
