"""Unbalance: a torque A sin(n angle + phase) of gravity on the rotor, which turns n times for one turn of the joint."""

import math
from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class Unbalance(Effect):
    """A once-a-turn gravity torque."""

    name = "unbalance"

    def applies(self, model: Model) -> bool:
        """Return whether the model has no load on an ungeared shaft, whose weight would include the effect."""
        return model.load.type == "none" or model.gear_ratio != 1.0

    def is_usual(self, travel: float) -> bool:
        """Return whether the joint makes whole turns, and so carries no arm."""
        return travel >= 2.0 * math.pi

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return cosine and sine of the rotor's angle, as torque that drives it."""
        if signals.angle is None:
            return {}
        cosine, sine = signals.waves(signals.model.gear_ratio)
        return {"drag": {"cos": -cosine, "sin": -sine}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return amplitude and phase."""
        amplitude = math.hypot(coefficients["cos"], coefficients["sin"])
        return {"amplitude": amplitude, "phase": math.atan2(coefficients["cos"], coefficients["sin"])}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a torque over the angle."""
        amplitude, phase, ratio = parameters["amplitude"], parameters["phase"], plant.model.gear_ratio
        plant.rotor_torque.append(lambda now: amplitude * np.sin(ratio * now.angle + phase))
