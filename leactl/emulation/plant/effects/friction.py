"""Friction that the nominal plant lacks: by direction, speed, angle, load, temperature and use."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leactl.emulation.plant.effects.contract import Now, PlantEffect, Value
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class PlantAsymmetricFriction(PlantEffect):
    """Coulomb friction that differs by direction.

    Level = Coulomb (1 +- asymmetry).
    """

    asymmetry: float = bounded(0.0, -0.95, 0.95)

    def coulomb(self, level: Value, now: Now) -> Value:
        """Change the level with the sign of the velocity before friction, which a sticking rotor has too."""
        return level * (1.0 + self.asymmetry * np.sign(now.velocity))


@dataclass(frozen=True)
class PlantStribeck(PlantEffect):
    """Friction that is higher near zero speed.

    Level = Coulomb (1 + ratio / (1 + (v / vs)^2)), the Lorentzian form of Hess and Soom.
    """

    breakaway_ratio: float = bounded(0.0, 0.0, 10.0)
    stribeck_velocity: float = bounded(1.0, 1e-3, 100.0)  # rad/s

    def coulomb(self, level: Value, now: Now) -> Value:
        """Raise the level at low speed."""
        share = now.velocity / self.stribeck_velocity
        return level * (1.0 + self.breakaway_ratio / (1.0 + share * share))


@dataclass(frozen=True)
class PlantQuadraticDrag(PlantEffect):
    """Drag of air or splashed grease.

    Torque = -coefficient velocity |velocity|.
    """

    adds_torque: ClassVar[bool] = True
    coefficient: float = bounded(0.0, 0.0, 1.0)  # N*m*s^2/rad^2

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Drag torque that opposes the motion."""
        return -self.coefficient * velocity * np.abs(velocity)


SLIDER_COUNT = 8


@dataclass(frozen=True)
class PlantPresliding(PlantEffect):
    """Friction that yields like a lossy spring before it slides.

    Spring-sliders that slip one after the other (Iwan, Prandtl): together a parabola up to `displacement`.
    """

    displacement: float = bounded(0.001, 1e-6, 1.0)  # rad

    def friction_path(self, lanes: int, step_s: float) -> Callable[[Value, Value], Value]:
        """Return a function that stretches each spring with the motion until its slider slips."""
        shares = (np.arange(SLIDER_COUNT) + 1.0)[:, None] / SLIDER_COUNT
        reach = shares * np.broadcast_to(self.displacement, (lanes,))
        stretch = np.zeros((SLIDER_COUNT, lanes))
        # equal springs whose reaches are spread evenly: the sum is u (2 - u) of the level at u = travel / displacement
        stiffness = 1.0 / reach.sum(axis=0)

        def step(level: Value, velocity: Value) -> Value:
            np.add(stretch, velocity * step_s, out=stretch)
            np.minimum(stretch, reach, out=stretch)
            np.maximum(stretch, -reach, out=stretch)
            return -level * stiffness * np.add.reduce(stretch, axis=0)

        return step


@dataclass(frozen=True)
class PlantPositionDependentFriction(PlantEffect):
    """Coulomb friction that varies over a turn: bearings around a ring that is not round.

    Level = Coulomb (1 + amplitude cos(order angle + phase)), never below zero.
    """

    amplitude: float = bounded(0.0, 0.0, 2.0)
    order: float = bounded(1.0, 1.0, 100.0)  # periods per revolution
    phase: float = bounded(0.0, -7.0, 7.0)  # rad

    def coulomb(self, level: Value, now: Now) -> Value:
        """Vary the level with the angle."""
        return level * np.maximum(1.0 + self.amplitude * np.cos(self.order * now.angle + self.phase), 0.0)


@dataclass(frozen=True)
class PlantLoadDependentFriction(PlantEffect):
    """Friction that grows with the torque transmitted, as in loaded bearings and teeth.

    Level = Coulomb + coefficient x torque, rounded below the bearings' own preload.
    """

    coefficient: float = bounded(0.0, 0.0, 2.0)

    def coulomb(self, level: Value, now: Now) -> Value:
        """Add the load's share, less the 0.15 N*m of the bearings' preload."""
        return level + self.coefficient * (np.hypot(now.shaft_torque, 0.15) - 0.15)


@dataclass(frozen=True)
class PlantFrictionTemperature(PlantEffect):
    """Friction that changes as the machine warms: grease thins, or seals tighten.

    Viscous damping and Coulomb friction x exp(coefficient (housing - 25 degC)), after Arrhenius.
    """

    coefficient: float = bounded(0.0, -0.1, 0.1)  # 1/K

    def friction_share(self, now: Now) -> Value:
        """Scale viscous damping and Coulomb friction by one factor."""
        return np.exp(np.clip(self.coefficient * (now.housing - 25.0), -2.0, 2.0))


@dataclass(frozen=True)
class PlantFrictionRunIn(PlantEffect):
    """Grease that is stiff after rest and settles with use.

    Excess x exp(-(t / time constant)^0.85): a stretched exponential, as many contacts settle at different rates.
    """

    excess: float = bounded(0.0, 0.0, 10.0)
    time_constant: float = bounded(10.0, 0.01, 10000.0)  # s

    def friction_share(self, now: Now) -> Value:
        """Scale viscous damping and Coulomb friction by one factor."""
        return 1.0 + self.excess * np.exp(-((now.time / self.time_constant) ** 0.85))
