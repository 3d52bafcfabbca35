"""Encoder eccentricity: the angle reads A sin(angle + phase) more."""

import math
from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class EncoderEccentricity(Effect):
    """A once-a-turn error of the angle."""

    name = "encoder_eccentricity"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return cosine and sine of the angle, as errors of the angle reading."""
        if signals.angle is None or signals.mechanical == "locked":
            return {}
        return {"angle_reading": {"cos": np.cos(signals.angle), "sin": np.sin(signals.angle)}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return amplitude and phase."""
        amplitude = math.hypot(coefficients["cos"], coefficients["sin"])
        return {"amplitude": amplitude, "phase": math.atan2(coefficients["cos"], coefficients["sin"])}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add an error of the angle, and thereby of the velocity."""
        amplitude, phase = parameters["amplitude"], parameters["phase"]
        plant.angle_error.append(lambda angle: amplitude * np.sin(angle + phase))
