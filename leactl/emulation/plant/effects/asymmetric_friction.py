"""Coulomb friction that differs by direction."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantAsymmetricFriction(PlantEffect):
    """Level = Coulomb (1 +- asymmetry)."""

    asymmetry: float = bounded(0.0, -0.95, 0.95)

    def coulomb(self, level: Value, now: Now) -> Value:
        """Take the direction in which the rotor turns, or would turn if it did not stick."""
        return level * (1.0 + self.asymmetry * np.sign(now.velocity))
