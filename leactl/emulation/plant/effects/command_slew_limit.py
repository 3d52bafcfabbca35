"""A drive whose current reference changes no faster than a fixed rate."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Path, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantCommandSlewLimit(PlantEffect):
    """The current reference changes by at most rate x step."""

    rate: float = bounded(1e6, 1e-3, 1e9)  # A/s

    def reference_path(self, lanes: int, step_s: float) -> Path:
        """Move towards the reference by at most rate x step."""
        followed = np.zeros(lanes)
        most = self.rate * step_s

        def step(reference: Value) -> Value:
            np.add(followed, np.minimum(np.maximum(reference - followed, -most), most), out=followed)
            return followed

        return step
