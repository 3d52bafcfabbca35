"""Gravity on an arm that the model leaves out: the drive has to hold A cos(angle + phase)."""

import math
from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model

FULL_TURN = 2.0 * math.pi  # rad


class GravityLoad(Effect):
    """The weight of an arm, over the joint's angle."""

    name = "gravity_load"

    def applies(self, model: Model) -> bool:
        """Return whether the model has no pendulum, whose weight includes the effect, and no bench shaft."""
        return model.load.type != "pendulum" and model.bench.shaft_stiffness is None

    def is_usual(self, travel: float) -> bool:
        """Return whether the joint makes no whole turn, and so may carry an arm."""
        return travel < FULL_TURN

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return cosine and sine of the joint's angle, as torque that the drive has to hold."""
        if signals.angle is None:
            return {}
        cosine, sine = signals.waves(1.0)
        return {"drag": {"cos": cosine, "sin": sine}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return amplitude and phase."""
        return {
            "amplitude": math.hypot(coefficients["cos"], coefficients["sin"]),
            "phase": math.atan2(-coefficients["sin"], coefficients["cos"]),
        }

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a torque over the angle."""
        amplitude, phase = parameters["amplitude"], parameters["phase"]
        plant.rotor_torque.append(lambda now: -amplitude * np.cos(now.angle + phase))
