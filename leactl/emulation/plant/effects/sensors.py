"""Sensors of current, motion and temperature whose readings differ from the true values."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Path, PlantEffect, Value
from leactl.emulation.plant.effects.lag_and_delay import Lag
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantCurrentSensorGain(PlantEffect):
    """A current sensor whose gain is wrong: the drive then regulates the wrong current.

    Reading = gain x current.
    """

    gain: float = bounded(1.0, 0.1, 10.0)

    def sense_current(self, current: float) -> float:
        """Multiply the current by the gain."""
        return self.gain * current


@dataclass(frozen=True)
class PlantCurrentSensorOffset(PlantEffect):
    """A current sensor whose zero is wrong: the drive regulates a current that differs from the command.

    Reading = current + offset.
    """

    offset: float = bounded(0.0, -10.0, 10.0)  # A, q axis

    def sense_current(self, current: float) -> float:
        """Add the offset to the current."""
        return current + self.offset


@dataclass(frozen=True)
class PlantEncoderEccentricity(PlantEffect):
    """An encoder whose scale is off centre.

    Error = amplitude sin(angle + phase), and a twentieth of it twice a turn.
    """

    amplitude: float = bounded(0.0, 0.0, 1.0)  # rad
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def encoder_error(self, angle: Value) -> Value:
        """Error with one period a turn, and a small part with two."""
        turn = angle + self.phase
        sine = np.sin(turn)
        return self.amplitude * sine * (1.0 + 0.1 * np.cos(turn))


@dataclass(frozen=True)
class PlantVelocityFilterLag(PlantEffect):
    """A reported velocity that lags more than the drive's filter does.

    A first-order lag in addition to the filter.
    """

    time_constant: float = bounded(0.001, 1e-6, 10.0)  # s

    def velocity_path(self, lanes: int, step_s: float) -> Path:
        """Return the lag, which starts from rest."""
        return Lag(self.time_constant, lanes, step_s)


@dataclass(frozen=True)
class PlantEmissivityBias(PlantEffect):
    """A camera set to the wrong emissivity.

    Reading = ambient + fraction x rise.
    """

    fraction: float = bounded(1.0, 0.01, 10.0)  # rise that the camera reads over the true rise

    def camera_reading(self, temperature: Value, ambient: Value) -> Value:
        """Scale the rise above ambient by the fraction."""
        return ambient + self.fraction * (temperature - ambient)
