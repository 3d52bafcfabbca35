"""A part attached to the rotor by a soft spring, such as a belt or a cable drum, with its own natural frequency."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from leactl.emulation.plant.effects.contract import Now, Value
from leactl.emulation.plant.effects_outside_library.drawn import Unlisted, between
from leactl.emulation.plant.parameters import bounded


@dataclass(frozen=True)
class HangingResonator(Unlisted):
    """Torque of a spring and a damper between the rotor and a second inertia."""

    inertia: float = bounded(4e-4, 1e-9, 10.0)  # kg*m^2
    frequency: float = bounded(15.0, 0.01, 500.0)  # Hz, with the rotor held
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
        """Step by semi-implicit Euler; the phase advances by at most 0.025 rad a step."""
        rate = 2.0 * np.pi * self.frequency
        stiffness, damping = self.inertia * rate**2, 2.0 * self.damping_ratio * self.inertia * rate
        twist, speed = np.zeros(lanes), np.zeros(lanes)

        def torque(now: Now) -> Value:
            relative = now.velocity - speed
            np.add(twist, relative * step_s, out=twist)
            force = stiffness * twist + damping * relative
            np.add(speed, force / self.inertia * step_s, out=speed)
            return -force

        return torque
