"""Friction that is higher near zero speed."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantStribeck(PlantEffect):
    """Level = Coulomb (1 + ratio / (1 + (v / vs)^2)), the Lorentzian form of Hess and Soom."""

    breakaway_ratio: float = bounded(0.0, 0.0, 10.0)
    stribeck_velocity: float = bounded(1.0, 1e-3, 100.0)  # rad/s

    def coulomb(self, level: Value, now: Now) -> Value:
        """Raise the level at low speed."""
        share = now.velocity / self.stribeck_velocity
        return level * (1.0 + self.breakaway_ratio / (1.0 + share * share))
