"""An encoder that occasionally gives wrong counts for some milliseconds."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from leactl.emulation.plant.effects.contract import Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class EncoderGlitches(Unlisted):
    """Errors of both signs, `rate` a second, each lasting 2 to 30 ms."""

    size: float = bounded(0.01, 0.0, 10.0)  # rad
    rate: float = bounded(1.0, 0.0, 100.0)  # 1/s
    key: float = bounded(0.0, 0.0, 1e6)

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw errors of 6 to 100 counts, 0.5 to 3 times a second."""
        return cls(
            size=between(0.001, 0.015, size),
            rate=float(draw.uniform(0.5, 3.0)),
            key=float(draw.integers(0, 1000000)),
        )

    def afresh(self, draw: np.random.Generator) -> Self:
        """Draw other times for the errors."""
        return replace(self, key=float(draw.integers(0, 1000000)))

    def angle_record(self, angle: Value, time: Value) -> Value:
        """Add the errors to the recorded angle."""
        count = len(angle)
        draw = np.random.default_rng(int(self.key))
        error = np.zeros(count)
        for first in draw.integers(0, count, draw.poisson(self.rate * float(time[-1, 0] - time[0, 0]))):
            error[first : first + int(draw.integers(2, 31))] = self.size * draw.choice([-1.0, 1.0])
        return angle + error[:, None]
