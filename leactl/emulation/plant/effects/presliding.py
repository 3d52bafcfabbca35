"""Friction that yields like a lossy spring before it slides."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect, Value
from leactl.emulation.plant.parameters import bounded

SLIDERS = 8


@dataclass(frozen=True)
class PlantPresliding(PlantEffect):
    """Spring-sliders that slip one after the other (Iwan, Prandtl): together a parabola up to `displacement`."""

    displacement: float = bounded(0.001, 1e-6, 1.0)  # rad

    def friction_path(self, lanes: int, step_s: float) -> Callable[[Value, Value], Value]:
        """Stretch each spring with the motion, up to where its slider slips."""
        shares = (np.arange(SLIDERS) + 1.0)[:, None] / SLIDERS
        reach = shares * np.broadcast_to(self.displacement, (lanes,))
        stretch = np.zeros((SLIDERS, lanes))
        # equal springs whose reaches are spread evenly: the sum is u (2 - u) of the level at u = travel / displacement
        stiffness = 1.0 / reach.sum(axis=0)

        def step(level: Value, velocity: Value) -> Value:
            np.add(stretch, velocity * step_s, out=stretch)
            np.minimum(stretch, reach, out=stretch)
            np.maximum(stretch, -reach, out=stretch)
            return -level * stiffness * np.add.reduce(stretch, axis=0)

        return step
