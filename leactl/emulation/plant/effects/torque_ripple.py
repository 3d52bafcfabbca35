"""Torque constant that varies with the rotor's angle."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTorqueRipple(PlantEffect):
    """Torque constant x (1 + amplitude [sin(order angle + phase) + a fifth of it at twice the order])."""

    amplitude: float = bounded(0.0, 0.0, 1.0)
    order: float = bounded(82.0, 1.0, 10000.0)  # periods per revolution
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque_share(self, now: Now) -> Value:
        """Sum the fundamental and the second harmonic of the back-EMF's departure from a sine."""
        turn = self.order * now.angle + self.phase
        sine = np.sin(turn)
        return 1.0 + self.amplitude * sine * (1.0 + 0.4 * np.cos(turn))
