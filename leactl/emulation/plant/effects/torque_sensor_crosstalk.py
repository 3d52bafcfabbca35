"""Misalignment that loads the torque sensor in bending once a turn."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTorqueSensorCrosstalk(PlantEffect):
    """Reading = torque + amplitude sin(angle + phase)."""

    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque_record(self, torque: Value, angle: Value, time: Value) -> Value:
        """Add the reading that bending causes."""
        return torque + self.amplitude * np.sin(angle + self.phase)
