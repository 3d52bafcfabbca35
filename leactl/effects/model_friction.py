"""The model file's friction torque, which effects of friction multiply by a share."""

import numpy as np
import numpy.typing as npt

from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]


def friction_torque(model: Model, velocity: Array, velocity_sign: Array) -> Array:
    """Return viscous and Coulomb friction torque [N*m], shape (samples,).

    Coefficients that the model file lacks count as 0.

    Parameters
    ----------
    velocity : rad/s, shape (samples,).
    velocity_sign : smoothed sign of the velocity, between -1 and 1, shape (samples,).
    """
    return (model.viscous_damping or 0.0) * velocity + (model.coulomb_friction or 0.0) * velocity_sign
