"""A supply with a resistance of its own."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantBusSag(PlantEffect):
    """The voltage at which source and load agree: V = source - resistance x power / V."""

    resistance: float = bounded(0.0, 0.0, 10.0)  # ohm

    def bus_voltage(self, source: Value, power: Value) -> Value:
        """Upper root of the quadratic; below what the source can give at most it stays at half."""
        return 0.5 * (source + np.sqrt(np.maximum(source * source - 4.0 * self.resistance * power, 0.0)))
