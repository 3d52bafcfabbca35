"""A drive that limits its current below the reference."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTorqueLimit(PlantEffect):
    """The current loop follows its reference up to a maximum current."""

    current: float = bounded(1e4, 1e-3, 1e6)  # A

    def bounded_reference(self, reference: Value, torque_constant: Value, velocity: Value) -> Value:
        """Clip the reference at the maximum, in both directions."""
        return np.minimum(np.maximum(reference, -self.current), self.current)
