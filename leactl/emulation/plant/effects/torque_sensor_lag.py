"""A torque channel that lags more than its filter does."""

from dataclasses import dataclass

from leactl.emulation.plant.effects.contract import Path, PlantEffect
from leactl.emulation.plant.effects.memory import Lag
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTorqueSensorLag(PlantEffect):
    """A first-order lag in addition to the filter."""

    time_constant: float = bounded(0.001, 1e-6, 10.0)  # s

    def torque_path(self, lanes: int, step_s: float) -> Path:
        """Apply the lag, from zero torque at the start."""
        return Lag(self.time_constant, lanes, step_s)
