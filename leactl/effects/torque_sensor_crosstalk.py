"""Torque sensor crosstalk: the reading has A sin(angle + phase) with no torque behind it."""

import math
from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class TorqueSensorCrosstalk(Effect):
    """A once-a-turn reading of misalignment."""

    name = "torque_sensor_crosstalk"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return cosine and sine of the angle, as errors of the torque reading."""
        if signals.torque is None or signals.mechanical == "free" or signals.angle is None:
            return {}
        cosine, sine = signals.waves(1.0)
        return {"torque_reading": {"cos": cosine, "sin": sine}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return amplitude and phase."""
        amplitude = math.hypot(coefficients["cos"], coefficients["sin"])
        return {"amplitude": amplitude, "phase": math.atan2(coefficients["cos"], coefficients["sin"])}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a reading over the angle."""
        amplitude, phase = parameters["amplitude"], parameters["phase"]
        plant.torque_reading.append(lambda run, reading: reading + amplitude * np.sin(run.angle + phase))
