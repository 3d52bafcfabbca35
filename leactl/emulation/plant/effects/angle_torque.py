"""Torques that depend on the rotor's angle."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantCogging(PlantEffect):
    """Torque that depends on the rotor's angle alone: teeth against magnets.

    Torque = amplitude [sin(order angle + phase) + a sixth of it at twice the order].
    """

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m
    order: float = bounded(82.0, 1.0, 10000.0)  # periods per revolution
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Sum the fundamental and the second harmonic; flat-topped teeth give both."""
        turn = self.order * angle + self.phase
        sine = np.sin(turn)
        return self.amplitude * sine * (1.0 + np.cos(turn) / 3.0)


@dataclass(frozen=True)
class PlantTorqueRipple(PlantEffect):
    """Torque constant that varies with the rotor's angle.

    Torque constant x (1 + amplitude [sin(order angle + phase) + a fifth of it at twice the order]).
    """

    amplitude: float = bounded(0.0, 0.0, 1.0)
    order: float = bounded(82.0, 1.0, 10000.0)  # periods per revolution
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque_share(self, now: Now) -> Value:
        """Sum the fundamental and the second harmonic of the back-EMF's departure from a sine."""
        turn = self.order * now.angle + self.phase
        sine = np.sin(turn)
        return 1.0 + self.amplitude * sine * (1.0 + 0.4 * np.cos(turn))


@dataclass(frozen=True)
class PlantGravityLoad(PlantEffect):
    """Gravity on an arm.

    A weight on an arm that is `phase` above level at angle zero; the torque falls as the arm rises.
    """

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.0, 0.0, 100.0)  # N*m, held out level
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Pull the arm down, in whichever direction it moves; the lever is the horizontal reach of the arm."""
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
        """Gravity torque of an eccentric mass at an angle."""
        return self.amplitude * np.sin(angle + self.phase)


HALF_TORQUE_ANGLE = 25.0  # rad (four turns) from the rest angle, at which slip halves the torque of Hooke's law


@dataclass(frozen=True)
class PlantPositionSpring(PlantEffect):
    """A cable that pulls the shaft back to a rest angle.

    Torque = -stiffness x / (1 + |x| / a few turns), where x is the angle from the rest angle.
    """

    adds_torque: ClassVar[bool] = True
    stiffness: float = bounded(0.0, 0.0, 1000.0)  # N*m/rad
    rest_angle: float = bounded(0.0, -1e6, 1e6)  # rad

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Follow Hooke's law near the rest angle; further away the cable slips on its drum."""
        deflection = angle - self.rest_angle
        return -self.stiffness * deflection / (1.0 + np.abs(deflection) / HALF_TORQUE_ANGLE)
