"""Nominal friction, as several effects scale it."""

import numpy as np
import numpy.typing as npt

from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]


def drag(model: Model, velocity: Array, sliding: Array) -> Array:
    """b w + f sgn(w) [N*m]; what the model leaves out counts as none."""
    return (model.viscous_damping or 0.0) * velocity + (model.coulomb_friction or 0.0) * sliding
