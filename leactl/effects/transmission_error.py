"""Transmission error: the angle reads A sin(n angle + phase) more, n being the gear's ratio or twice that."""

import math
from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class TransmissionError(Effect):
    """A gear that does not turn evenly."""

    name = "transmission_error"
    forms = ((1.0,), (2.0,))  # orders at the joint, as multiples of the gear's ratio
    continuous = False

    def applies(self, model: Model) -> bool:
        """Return whether the model has a gear, whose ratio gives the orders."""
        return model.gear_ratio != 1.0

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return cosine and sine of the motor's angle, as an error of the joint's angle."""
        if signals.angle is None or signals.mechanical != "free":
            return {}
        wave_angle = form[0] * signals.model.gear_ratio * signals.angle
        return {"angle_reading": {"cos": np.cos(wave_angle), "sin": np.sin(wave_angle)}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return amplitude, order at the joint, and phase."""
        amplitude = math.hypot(coefficients["cos"], coefficients["sin"])
        order = form[0] * model.gear_ratio
        return {"amplitude": amplitude, "order": order, "phase": math.atan2(coefficients["cos"], coefficients["sin"])}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add an error of the angle, and thereby of the velocity."""
        amplitude, order, phase = (parameters[name] for name in ("amplitude", "order", "phase"))
        plant.angle_error.append(lambda angle: amplitude * np.sin(order * angle + phase))
