"""A torque channel whose zero drifts with time."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTorqueSensorDrift(PlantEffect):
    """Zero = rate x time, levelling off over ten minutes as an amplifier warms."""

    rate: float = bounded(0.0, -1.0, 1.0)  # N*m/s

    def torque_record(self, torque: Value, angle: Value, time: Value) -> Value:
        """Add the drift of the zero."""
        return torque + self.rate * 600.0 * -np.expm1(-time / 600.0)
