"""A terminal with intermittent contact: the resistance rises for a while and returns."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from leactl.emulation.plant.effects.contract import Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class LooseTerminal(Unlisted):
    """Resistance x (1 + share) while a sum of three incommensurate sines of time is high."""

    share: float = bounded(0.1, 0.0, 10.0)
    period: float = bounded(7.0, 0.1, 1000.0)  # s
    phase: float = bounded(0.0, 0.0, 7.0)  # rad

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a rise by 3 to 50 % of the resistance, for a fifth of the time."""
        return cls(
            share=between(0.03, 0.5, size), period=float(draw.uniform(3.0, 9.0)), phase=float(draw.uniform(0.0, 6.28))
        )

    def afresh(self, draw: np.random.Generator) -> Self:
        """Draw other times for the bad contact."""
        return replace(self, phase=float(draw.uniform(0.0, 6.28)))

    def resistance_share(self, winding: Value, time: float) -> Value:
        """Factor of 1 + share during bad contact, else 1."""
        turn = 2.0 * np.pi * time / self.period + self.phase
        waves = np.sin(turn) + np.sin(1.618 * turn + 1.0) + np.sin(2.449 * turn + 2.0)
        return 1.0 + self.share * (waves > 1.2)
