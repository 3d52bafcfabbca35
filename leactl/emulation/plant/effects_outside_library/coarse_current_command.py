"""A drive that rounds its current command to coarse steps and ignores smaller changes."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from leactl.emulation.plant.effects.contract import Path, Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class CoarseCurrentCommand(Unlisted):
    """The current loop follows the reference rounded to a step."""

    step: float = bounded(0.1, 1e-6, 100.0)  # A

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a step between 0.06 and 0.8 A."""
        return cls(step=between(0.06, 0.8, size))

    def reference_path(self, lanes: int, step_s: float) -> Path:
        """Round the reference to the step."""

        def followed(reference: Value) -> Value:
            return np.rint(reference / self.step) * self.step

        return followed
