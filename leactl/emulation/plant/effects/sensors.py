"""Sensors of current, motion and temperature whose readings differ from the true values."""

from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import Path, PlantEffect, Value
from leactl.emulation.plant.effects.lag_and_delay import Lag
from leactl.emulation.plant.parameters import bounded

SECOND_HARMONIC_SHARE = 0.05  # of an eccentric scale's error: amplitude of two periods a turn over that of one


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

    Error = amplitude (sin x + 0.05 sin 2x), where x = angle + phase.
    """

    amplitude: float = bounded(0.0, 0.0, 1.0)  # rad
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def encoder_error(self, angle: Value) -> Value:
        """Return the error [rad]: one period a turn, and a small part with two."""
        scale_angle = angle + self.phase
        sine = np.sin(scale_angle)
        return self.amplitude * sine * (1.0 + 2.0 * SECOND_HARMONIC_SHARE * np.cos(scale_angle))


@dataclass(frozen=True)
class PlantVelocityFilterLag(PlantEffect):
    """A velocity reading that has a first-order lag in addition to the drive's filter."""

    time_constant: float = bounded(0.001, 1e-6, 10.0)  # s

    def velocity_path(self, lanes: int, step_s: float) -> Path:
        """Return the lag, which starts from rest.

        Parameters
        ----------
        lanes : number of plants that are simulated at once.
        step_s : time between two calls [s].
        """
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
