"""An inverter that loses voltage, with the sign of the current."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantDeadTime(PlantEffect):
    """Loss = voltage x i / sqrt(i^2 + current^2)."""

    voltage: float = bounded(0.0, 0.0, 20.0)  # V
    current: float = bounded(0.3, 1e-3, 100.0)  # A

    def lost_voltage(self, current: Value) -> Value:
        """Rise with the current and saturate."""
        return self.voltage * current / np.hypot(current, self.current)
