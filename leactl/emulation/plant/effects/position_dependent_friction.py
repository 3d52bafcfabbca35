"""Coulomb friction that varies over a turn: bearings around a ring that is not round."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantPositionDependentFriction(PlantEffect):
    """Level = Coulomb (1 + amplitude cos(order angle + phase)), never below zero."""

    amplitude: float = bounded(0.0, 0.0, 2.0)
    order: float = bounded(1.0, 1.0, 100.0)  # periods per revolution
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def coulomb(self, level: Value, now: Now) -> Value:
        """Vary the level with the angle."""
        return level * np.maximum(1.0 + self.amplitude * np.cos(self.order * now.angle + self.phase), 0.0)
