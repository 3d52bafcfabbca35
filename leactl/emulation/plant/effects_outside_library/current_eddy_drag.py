"""Eddy currents that the armature's field induces in the housing: a drag that grows with current squared and speed."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from leactl.emulation.plant.effects.contract import Now, Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class CurrentEddyDrag(Unlisted):
    """Torque = -coefficient i^2 w / (1 + |w| / 20 rad/s)."""

    coefficient: float = bounded(1e-4, 0.0, 1.0)  # N*m*s/rad/A^2

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a drag of 0.03 to 0.6 N*m at 15 A and 10 rad/s."""
        return cls(coefficient=between(2e-5, 4e-4, size))

    def rotor_path(self, lanes: int, step_s: float) -> Callable[[Now], Value]:
        """Drag torque that opposes the motion."""

        def torque(now: Now) -> Value:
            speed = now.velocity / (1.0 + np.abs(now.velocity) / 20.0)
            return -self.coefficient * now.current * now.current * speed

        return torque
