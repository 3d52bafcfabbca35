"""Base class of the effects of this package: each can be drawn at random with a given size."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect


@dataclass(frozen=True)
class Unlisted(PlantEffect):
    """An effect without a name in the vocabulary."""

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw an effect with a size from 0, barely visible, to 1, obvious."""
        raise NotImplementedError

    def afresh(self, draw: np.random.Generator) -> Self:
        """Return the same effect for another run, with its random times drawn again if it has any."""
        return self


def between(low: float, high: float, size: float) -> float:
    """Return the value at a size between `low` (size 0) and `high` (size 1), on a logarithmic scale."""
    return float(low * (high / low) ** size)
