"""A terminal that now and then makes bad contact: resistance jumps up for a while and comes back."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from leactl.emulation.plant.effects.contract import Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class LooseTerminal(Unlisted):
    """Resistance x (1 + share) where a sum of three incommensurate waves of time is high."""

    share: float = bounded(0.1, 0.0, 10.0)
    period: float = bounded(7.0, 0.1, 1000.0)  # s
    phase: float = bounded(0.0, 0.0, 7.0)  # rad

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """3 to 50 % of the resistance, a fifth of the time."""
        return cls(
            share=between(0.03, 0.5, size), period=float(draw.uniform(3.0, 9.0)), phase=float(draw.uniform(0.0, 6.28))
        )

    def afresh(self, draw: np.random.Generator) -> Self:
        """Other moments."""
        return replace(self, phase=float(draw.uniform(0.0, 6.28)))

    def resistance_share(self, winding: Value, time: float) -> Value:
        """High or normal."""
        turn = 2.0 * np.pi * time / self.period + self.phase
        waves = np.sin(turn) + np.sin(1.618 * turn + 1.0) + np.sin(2.449 * turn + 2.0)
        return 1.0 + self.share * (waves > 1.2)
