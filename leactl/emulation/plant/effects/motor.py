"""Magnets, copper and iron that depart from the nominal motor."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantMagnetTemperature(PlantEffect):
    """Magnets that weaken as they warm; they have the housing's temperature.

    Torque and back-EMF constant x exp(-coefficient (housing - 25 degC)).
    """

    coefficient: float = bounded(0.0, 0.0, 0.05)  # 1/K

    def magnet_share(self, now: Now) -> Value:
        """Return one factor for torque constant and back-EMF constant."""
        return np.exp(-self.coefficient * (now.housing - 25.0))


@dataclass(frozen=True)
class PlantResistanceTemperature(PlantEffect):
    """Copper whose resistance rises with temperature, where the nominal model has no coefficient.

    Resistance x (1 + coefficient (winding - 25 degC)).
    """

    coefficient: float = bounded(0.0, 0.0, 0.02)  # 1/K

    def resistance_share(self, winding: Value, time: float) -> Value:
        """Return a factor that grows linearly, as that of copper does within 1 % up to 150 degC."""
        return 1.0 + self.coefficient * (winding - 25.0)


@dataclass(frozen=True)
class PlantSaturation(PlantEffect):
    """Iron that saturates: torque grows less than in proportion to the current.

    Torque constant / sqrt(1 + (i / knee)^2), with the knee at which the share `loss` is lost at 25 A.
    """

    loss: float = bounded(0.0, 0.0, 0.9)

    def torque_share(self, now: Now) -> Value:
        """Return the factor on the torque constant, which is the same for both signs of the current."""
        steepness = ((1.0 - self.loss) ** -2 - 1.0) / 625.0
        return 1.0 / np.sqrt(1.0 + steepness * now.current * now.current)
