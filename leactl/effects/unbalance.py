"""Unbalance: a torque A sin(angle + phase) of gravity on the rotor."""

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
        """On a pendulum it is part of the weight that hangs there."""
        return model.load.type == "none"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Sine and cosine of the angle, as torque that drives the rotor."""
        if signals.angle is None:
            return {}
        return {"drag": {"cos": -np.cos(signals.angle), "sin": -np.sin(signals.angle)}}

    def parameters(self, form: Form, found: Mapping[str, float], model: Model) -> dict[str, float]:
        """Amplitude and phase."""
        amplitude = math.hypot(found["cos"], found["sin"])
        return {"amplitude": amplitude, "phase": math.atan2(found["cos"], found["sin"])}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """A torque over the angle."""
        amplitude, phase = parameters["amplitude"], parameters["phase"]
        plant.rotor_torque.append(lambda now: amplitude * np.sin(now.angle + phase))
