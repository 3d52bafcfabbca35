"""Dirt that passes through a bearing: friction rises for a fraction of a second, at irregular times."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from leactl.emulation.plant.effects.contract import Now, Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class FrictionBursts(Unlisted):
    """Friction x (1 + share) in a twelfth of all intervals, chosen by a hash of the interval's number."""

    share: float = bounded(0.5, 0.0, 50.0)
    interval: float = bounded(0.4, 0.001, 100.0)  # s
    key: float = bounded(0.0, 0.0, 1e6)

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a rise of 0.3 to 4 times the friction."""
        return cls(
            share=between(0.3, 4.0, size),
            interval=float(draw.uniform(0.15, 0.6)),
            key=float(draw.integers(0, 1000000)),
        )

    def afresh(self, draw: np.random.Generator) -> Self:
        """Draw other times for the bursts."""
        return replace(self, key=float(draw.integers(0, 1000000)))

    def friction_share(self, now: Now) -> Value:
        """Factor of 1 + share within a burst, else 1."""
        scattered = np.sin((np.floor(now.time / self.interval) + self.key) * 12.9898) * 43758.5453
        return 1.0 + self.share * (scattered - np.floor(scattered) < 1.0 / 12.0)
