"""A drive that reduces its current at speed."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded

STANDSTILL = 1e-6  # rad/s, below which no power flows


@dataclass(frozen=True)
class PlantPowerFoldback(PlantEffect):
    """The current loop follows its reference as far as the power limit allows."""

    power: float = bounded(1e6, 1e-3, 1e9)  # W

    def bounded_reference(self, reference: Value, torque_constant: Value, velocity: Value) -> Value:
        """Limit the current so that torque constant times velocity times current stays within the power."""
        most = self.power / (torque_constant * np.maximum(np.abs(velocity), STANDSTILL))
        return np.minimum(np.maximum(reference, -most), most)
