"""A torque sensor whose reading depends on the direction from which the torque comes."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded

REACHES = np.array([0.1, 0.25, 0.5])  # of the swing


@dataclass(frozen=True)
class PlantTorqueSensorHysteresis(PlantEffect):
    """Sliders in the sensor's spring slip one after the other; the reading lags by the torque that they hold."""

    needs_whole_record: ClassVar[bool] = True
    width: float = bounded(0.0, 0.0, 0.5)  # half width of the loop as a share of the record's torque swing

    def torque_record(self, torque: Value, angle: Value, time: Value) -> Value:
        """Subtract the mean torque that the sliders hold back, which is limited by the reach of each."""
        swing = 0.5 * (torque.max(axis=0) - torque.min(axis=0)) + 1e-9
        reach = REACHES[:, None] * swing
        share = self.width / REACHES.mean()
        held = np.zeros_like(reach)
        before = torque[0]
        reading = np.empty_like(torque)
        for k, now in enumerate(torque):
            np.add(held, now - before, out=held)
            np.minimum(np.maximum(held, -reach, out=held), reach, out=held)
            reading[k] = now - share * held.mean(axis=0)
            before = now
        return reading
