"""A supply with an internal resistance."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantBusSag(PlantEffect):
    """Voltage at which source and load agree: V = source - resistance x power / V."""

    resistance: float = bounded(0.0, 0.0, 10.0)  # ohm

    def bus_voltage(self, source: Value, power: Value) -> Value:
        """Return the upper root of the quadratic; half the source voltage if the source cannot supply the power."""
        return 0.5 * (source + np.sqrt(np.maximum(source * source - 4.0 * self.resistance * power, 0.0)))
