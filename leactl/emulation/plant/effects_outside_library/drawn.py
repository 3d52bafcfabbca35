"""What the effects of this room have in common: they are drawn by one number."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect


@dataclass(frozen=True)
class Unlisted(PlantEffect):
    """An effect without a name in the vocabulary."""

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Make one of a size from 0, hardly seen, to 1, plain to see."""
        raise NotImplementedError

    def afresh(self, draw: np.random.Generator) -> Self:
        """The same effect in another run, where chance plays a part in it."""
        return self


def between(low: float, high: float, size: float) -> float:
    """A number from `low` to `high` on a logarithmic scale."""
    return float(low * (high / low) ** size)
