"""Torque sensors whose readings differ from the shaft's torque, or come late."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import Path, PlantEffect, Value
from leactl.emulation.plant.effects.lag_and_delay import Delay, Lag
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantTorqueSensorGain(PlantEffect):
    """A torque sensor whose calibration is wrong by a factor.

    Reading = gain x torque.
    """

    gain: float = bounded(1.0, 0.1, 10.0)

    def sense_torque(self, torque: float) -> float:
        """Return the torque [N*m] times the gain."""
        return self.gain * torque


@dataclass(frozen=True)
class PlantTorqueSensorOffset(PlantEffect):
    """A torque sensor whose zero is wrong.

    Reading = torque + offset.
    """

    offset: float = bounded(0.0, -100.0, 100.0)  # N*m

    def sense_torque(self, torque: float) -> float:
        """Return the torque plus the offset [N*m]."""
        return torque + self.offset


@dataclass(frozen=True)
class PlantTorqueSensorDrift(PlantEffect):
    """A torque channel whose zero drifts with time.

    Zero = rate T (1 - exp(-time / T)): it levels off over T = ten minutes, as an amplifier warms.
    """

    rate: float = bounded(0.0, -1.0, 1.0)  # N*m/s

    def torque_record(self, torque: Value, angle: Value, time: Value) -> Value:
        """Return the torque plus the drift of the zero [N*m]."""
        return torque + self.rate * 600.0 * -np.expm1(-time / 600.0)


@dataclass(frozen=True)
class PlantTorqueSensorCrosstalk(PlantEffect):
    """Misalignment that loads the torque sensor in bending once a turn.

    Reading = torque + amplitude sin(angle + phase).
    """

    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque_record(self, torque: Value, angle: Value, time: Value) -> Value:
        """Return the torque plus the reading that bending causes [N*m]."""
        return torque + self.amplitude * np.sin(angle + self.phase)


REACH_SHARES = np.array([0.1, 0.25, 0.5])  # reach of each slider over the amplitude of the torque


@dataclass(frozen=True)
class PlantTorqueSensorHysteresis(PlantEffect):
    """A torque sensor whose reading depends on the direction from which the torque comes.

    Sliders in the sensor's spring slip one after the other; the reading lags by the torque that they hold.
    """

    needs_whole_record: ClassVar[bool] = True
    width: float = bounded(0.0, 0.0, 0.5)  # half width of the loop over the amplitude of the record's torque

    def torque_record(self, torque: Value, angle: Value, time: Value) -> Value:
        """Return the torque less the mean torque that the sliders hold, which the reach of each limits [N*m]."""
        amplitude = 0.5 * (torque.max(axis=0) - torque.min(axis=0)) + 1e-9
        reach = REACH_SHARES[:, None] * amplitude
        reading_per_held = self.width / REACH_SHARES.mean()
        held_torque = np.zeros_like(reach)
        previous_torque = torque[0]
        reading = np.empty_like(torque)
        for k, present_torque in enumerate(torque):
            np.add(held_torque, present_torque - previous_torque, out=held_torque)
            np.minimum(np.maximum(held_torque, -reach, out=held_torque), reach, out=held_torque)
            reading[k] = present_torque - reading_per_held * held_torque.mean(axis=0)
            previous_torque = present_torque
        return reading


@dataclass(frozen=True)
class PlantTorqueSensorLag(PlantEffect):
    """A torque channel that lags more than its filter does.

    A first-order lag in addition to the filter.
    """

    time_constant: float = bounded(0.001, 1e-6, 10.0)  # s

    def torque_path(self, lanes: int, step_s: float) -> Path:
        """Return the lag, which starts from zero torque."""
        return Lag(self.time_constant, lanes, step_s)


@dataclass(frozen=True)
class PlantTimeSkew(PlantEffect):
    """A torque stream that is late relative to the drive's streams.

    The reading is the torque of a time `delay` before.
    """

    delay: float = bounded(0.0, 0.0, 0.5)  # s

    def torque_path(self, lanes: int, step_s: float) -> Path:
        """Return the delay line of the torque reading."""
        return Delay(self.delay, lanes, step_s)
