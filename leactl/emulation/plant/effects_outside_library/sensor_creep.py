"""A torque sensor whose glue creeps: after a change of torque the reading keeps changing for half a minute."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.signal import lfilter

from leactl.emulation.plant.effects.contract import Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class SensorCreep(Unlisted):
    """Reading = torque + share x torque behind a slow lag."""

    share: float = bounded(0.01, 0.0, 1.0)
    time_constant: float = bounded(10.0, 0.1, 1000.0)  # s

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a creep of 0.6 to 8 % of the torque within 4 to 15 s."""
        return cls(share=between(0.006, 0.08, size), time_constant=float(draw.uniform(4.0, 15.0)))

    def torque_record(self, torque: Value, angle: Value, time: Value) -> Value:
        """Add the creep to the recorded torque."""
        step = float(time[1, 0] - time[0, 0])
        gain = -np.expm1(-step / self.time_constant)
        return torque + self.share * lfilter([gain], [1.0, gain - 1.0], torque, axis=0)
