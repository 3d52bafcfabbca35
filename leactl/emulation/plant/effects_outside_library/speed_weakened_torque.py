"""A commutation that lags with speed, so that the torque per ampere falls as the rotor turns faster."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from leactl.emulation.plant.effects.contract import Now, Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class SpeedWeakenedTorque(Unlisted):
    """Torque constant x cos(lag), where the lag grows with speed."""

    lag_per_speed: float = bounded(0.01, 0.0, 1.0)  # s, electrical angle over mechanical speed

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a lag of 0.15 to 0.7 rad at 25 rad/s: 1 to 23 % of the torque."""
        return cls(lag_per_speed=between(0.006, 0.028, size))

    def torque_share(self, now: Now) -> Value:
        """Reduce the torque alike in both directions of rotation."""
        return np.cos(np.minimum(np.abs(self.lag_per_speed * now.velocity), 1.5))
