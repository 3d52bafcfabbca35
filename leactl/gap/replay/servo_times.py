"""How fast a servo of a model answers, and what follows for the steps of its simulation."""

import math

import numpy as np
import numpy.typing as npt

from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
STEPS = 0.1  # of a servo's shortest time, that a step of its simulation may last
FORGETS = 6.0  # of its longest, after which it matters no more where it began


def times_of(model: Model, gain: Array, lightest: float, heaviest: float) -> tuple[float, float]:
    """The shortest and the longest time [s] in which servos of a model answer.

    Back-EMF slows the axis down, the gain swings it, and drives it home where back-EMF holds it back.
    """
    constant, resistance = model.torque_constant or 0.0, model.phase_resistance or math.inf
    rotor, drive = model.rotor_inertia or 0.0, model.drive
    holding = (constant * (constant + (drive.damping if drive else 0.0))) / resistance + (model.viscous_damping or 0.0)
    slowing = [(rotor + load) / holding if holding else math.inf for load in (lightest, heaviest)]
    stiff, soft = float(np.max(gain)), float(np.min(gain))
    swinging = math.sqrt((rotor + lightest) * resistance / (stiff * constant)) if stiff * constant else math.inf
    homing = holding * resistance / (soft * constant) if soft * constant else 0.0
    return min(slowing[0], swinging), max(slowing[1], homing)
