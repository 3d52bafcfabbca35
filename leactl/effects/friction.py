"""Nominal friction, as several effects scale it."""

import numpy as np
import numpy.typing as npt

from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]


def friction_torque(model: Model, velocity: Array, sliding: Array) -> Array:
    """The model's viscous and Coulomb friction torque [N*m], shape (samples,); a missing coefficient is 0."""
    return (model.viscous_damping or 0.0) * velocity + (model.coulomb_friction or 0.0) * sliding
