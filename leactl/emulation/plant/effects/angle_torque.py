"""Torques that depend on the rotor's angle."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantCogging(PlantEffect):
    """Torque that depends on the rotor's angle alone: teeth against magnets.

    Torque = amplitude (sin x + sin(2 x) / 6), where x = order angle + phase.
    """

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m
    order: float = bounded(82.0, 1.0, 10000.0)  # periods per revolution
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Return the sum of the fundamental and the second harmonic [N*m]; flat-topped teeth give both."""
        period_angle = self.order * angle + self.phase
        sine = np.sin(period_angle)
        return self.amplitude * sine * (1.0 + np.cos(period_angle) / 3.0)


@dataclass(frozen=True)
class PlantTorqueRipple(PlantEffect):
    """Torque constant that varies with the rotor's angle.

    Torque constant x (1 + amplitude (sin x + sin(2 x) / 5)), where x = order angle + phase.
    """

    amplitude: float = bounded(0.0, 0.0, 1.0)
    order: float = bounded(82.0, 1.0, 10000.0)  # periods per revolution
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque_share(self, now: Now) -> Value:
        """Return one plus the fundamental and the second harmonic of the back-EMF's departure from a sine."""
        period_angle = self.order * now.angle + self.phase
        sine = np.sin(period_angle)
        return 1.0 + self.amplitude * sine * (1.0 + 0.4 * np.cos(period_angle))


@dataclass(frozen=True)
class PlantGravityLoad(PlantEffect):
    """Gravity on an arm that is `phase` above the horizontal at angle zero.

    Torque = -amplitude cos(angle + phase).
    """

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m, with the arm horizontal
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Return the torque of the weight [N*m], whose lever is the horizontal reach of the arm."""
        reach = np.cos(angle) * np.cos(self.phase) - np.sin(angle) * np.sin(self.phase)
        return -self.amplitude * reach


@dataclass(frozen=True)
class PlantUnbalance(PlantEffect):
    """Gravity on an eccentric mass.

    Torque = amplitude sin(angle + phase).
    """

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Return the gravity torque of an eccentric mass at an angle [N*m]."""
        return self.amplitude * np.sin(angle + self.phase)


HALF_TORQUE_ANGLE = 25.0  # rad (four turns) from the rest angle, at which slip halves the torque of Hooke's law


@dataclass(frozen=True)
class PlantPositionSpring(PlantEffect):
    """A cable that pulls the shaft back to a rest angle.

    Torque = -stiffness x / (1 + |x| / HALF_TORQUE_ANGLE), where x is the angle from the rest angle.
    """

    adds_torque: ClassVar[bool] = True
    stiffness: float = bounded(0.0, 0.0, 1000.0)  # N*m/rad
    rest_angle: float = bounded(0.0, -1e6, 1e6)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Return the torque [N*m]: Hooke's law near the rest angle, less further away, where the cable slips."""
        deflection = angle - self.rest_angle
        return -self.stiffness * deflection / (1.0 + np.abs(deflection) / HALF_TORQUE_ANGLE)
