"""An encoder whose scale is off centre."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantEncoderEccentricity(PlantEffect):
    """Error = amplitude sin(angle + phase), and a twentieth of it twice a turn."""

    amplitude: float = bounded(0.0, 0.0, 1.0)  # rad
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def encoder_error(self, angle: Value) -> Value:
        """Error with one period a turn, and a small part with two."""
        turn = angle + self.phase
        sine = np.sin(turn)
        return self.amplitude * sine * (1.0 + 0.1 * np.cos(turn))
