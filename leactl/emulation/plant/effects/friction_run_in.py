"""Grease that is stiff after rest and settles with use."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantFrictionRunIn(PlantEffect):
    """Excess x exp(-(t / time constant)^0.85): a stretched exponential, as many contacts settle at different rates."""

    excess: float = bounded(0.0, 0.0, 10.0)
    time_constant: float = bounded(10.0, 0.01, 10000.0)  # s

    def friction_share(self, now: Now) -> Value:
        """Scale viscous damping and Coulomb friction by one factor."""
        return 1.0 + self.excess * np.exp(-((now.time / self.time_constant) ** 0.85))
