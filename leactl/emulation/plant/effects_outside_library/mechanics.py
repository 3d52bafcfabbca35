"""Mechanical effects without a name in the vocabulary."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from leactl.emulation.plant.effects.contract import Now, Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class FrictionBursts(Unlisted):
    """Dirt that passes through a bearing: friction rises for a fraction of a second, at irregular times.

    Friction x (1 + share) in a twelfth of all intervals, chosen by a hash of the interval's number.
    """

    share: float = bounded(0.5, 0.0, 50.0)
    interval: float = bounded(0.4, 0.001, 100.0)  # s
    key: float = bounded(0.0, 0.0, 1e6)  # chooses the intervals with a burst

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a rise of 0.3 to 4 times the friction."""
        return cls(
            share=between(0.3, 4.0, size),
            interval=float(draw.uniform(0.15, 0.6)),
            key=float(draw.integers(0, 1000000)),
        )

    def afresh(self, draw: np.random.Generator) -> Self:
        """Draw other times for the bursts."""
        return replace(self, key=float(draw.integers(0, 1000000)))

    def friction_share(self, now: Now) -> Value:
        """Return 1 + share within a burst, else 1."""
        hashed = np.sin((np.floor(now.time / self.interval) + self.key) * 12.9898) * 43758.5453
        return 1.0 + self.share * (hashed - np.floor(hashed) < 1.0 / 12.0)


@dataclass(frozen=True)
class HangingResonator(Unlisted):
    """A part attached to the rotor by a soft spring, such as a belt or a cable drum, with its own natural frequency.

    Torque of a spring and a damper between the rotor and a second inertia.
    """

    inertia: float = bounded(4e-4, 1e-9, 10.0)  # kg*m^2
    frequency: float = bounded(15.0, 0.01, 500.0)  # Hz, natural frequency with the rotor held
    damping_ratio: float = bounded(0.05, 0.0, 2.0)

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw 4 to 50 % of the rotor's inertia at 5 to 40 Hz."""
        return cls(
            inertia=between(1e-4, 1.2e-3, size),
            frequency=float(draw.uniform(5.0, 40.0)),
            damping_ratio=float(draw.uniform(0.02, 0.1)),
        )

    def rotor_path(self, lanes: int, step_s: float) -> Callable[[Now], Value]:
        """Return a function that steps the part by semi-implicit Euler, with at most 0.025 rad of its phase a step."""
        angular_frequency = 2.0 * np.pi * self.frequency
        stiffness, damping = (
            self.inertia * angular_frequency**2,
            2.0 * self.damping_ratio * self.inertia * angular_frequency,
        )
        twist, part_velocity = np.zeros(lanes), np.zeros(lanes)

        def torque(now: Now) -> Value:
            """Advance the part by a step; return its torque on the rotor [N*m]."""
            relative_velocity = now.velocity - part_velocity
            np.add(twist, relative_velocity * step_s, out=twist)
            spring_torque = stiffness * twist + damping * relative_velocity
            np.add(part_velocity, spring_torque / self.inertia * step_s, out=part_velocity)
            return -spring_torque

        return torque


@dataclass(frozen=True)
class WindingCable(Unlisted):
    """A cable that the rotor winds up: a torque that depends on the unwrapped angle and does not repeat every turn.

    Torque = -amplitude x a sum of three sines of the angle with incommensurate periods.
    """

    adds_torque: ClassVar[bool] = True
    amplitude: float = bounded(0.05, 0.0, 10.0)  # N*m
    wave: float = bounded(9.0, 0.1, 1000.0)  # rad, longest period
    phase: float = bounded(0.0, 0.0, 7.0)  # rad

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw an amplitude of 0.012 to 0.25 N*m over two to five turns."""
        return cls(
            amplitude=between(0.012, 0.25, size),
            wave=float(draw.uniform(13.0, 31.0)),
            phase=float(draw.uniform(0.0, 6.28)),
        )

    def torque(self, angle: Value, velocity: Value) -> Value:
        """Return the torque at the unwrapped angle [N*m]."""
        phase_angle = 2.0 * np.pi * angle / self.wave + self.phase
        waves = np.sin(phase_angle) + 0.7 * np.sin(2.236 * phase_angle + 1.3) + 0.5 * np.sin(3.873 * phase_angle + 0.4)
        return -0.7 * self.amplitude * waves


@dataclass(frozen=True)
class CurrentEddyDrag(Unlisted):
    """Eddy currents that the armature's field induces in the housing: a drag that grows with current squared and speed.

    Torque = -coefficient i^2 w / (1 + |w| / 20 rad/s).
    """

    coefficient: float = bounded(1e-4, 0.0, 1.0)  # N*m*s/rad/A^2

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a drag of 0.03 to 0.6 N*m at 15 A and 10 rad/s."""
        return cls(coefficient=between(2e-5, 4e-4, size))

    def rotor_path(self, lanes: int, step_s: float) -> Callable[[Now], Value]:
        """Return a function for the drag torque [N*m], which opposes the motion."""

        def torque(now: Now) -> Value:
            saturating_speed = now.velocity / (1.0 + np.abs(now.velocity) / 20.0)
            return -self.coefficient * now.current * now.current * saturating_speed

        return torque


@dataclass(frozen=True)
class SpeedWeakenedTorque(Unlisted):
    """A commutation that lags with speed, so that the torque per ampere falls as the rotor turns faster.

    Torque constant x cos(lag), where the lag grows with speed.
    """

    lag_per_speed: float = bounded(0.01, 0.0, 1.0)  # s, electrical angle over mechanical speed

    @classmethod
    def drawn(cls, draw: np.random.Generator, size: float) -> Self:
        """Draw a lag of 0.15 to 0.7 rad at 25 rad/s: 1 to 23 % of the torque."""
        return cls(lag_per_speed=between(0.006, 0.028, size))

    def torque_share(self, now: Now) -> Value:
        """Return the factor on the torque constant, which is the same for both directions of rotation."""
        return np.cos(np.minimum(np.abs(self.lag_per_speed * now.velocity), 1.5))
