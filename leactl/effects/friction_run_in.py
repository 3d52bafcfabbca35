"""Friction times 1 + e exp(-t / T) from the start of a run."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.model_friction import friction_torque
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class FrictionRunIn(Effect):
    """Friction that settles with use."""

    name = "friction_run_in"
    relative_to = ("coulomb_friction", "viscous_damping")
    one_sided = True
    forms = ((0.05,), (0.15,), (0.4,), (0.8,))
    form_scales = ("longest run",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the nominal friction, decaying over the run."""
        if signals.sliding is None or signals.velocity is None or signals.model.coulomb_friction is None:
            return {}
        friction = friction_torque(signals.model, signals.velocity, signals.sliding)
        return {"drag": {"excess": friction * np.exp(-signals.time / form[0])}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return excess and time constant."""
        return {"excess": coefficients["excess"], "time_constant": form[0]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add friction that settles over the run."""
        excess, time_constant = parameters["excess"], parameters["time_constant"]
        plant.friction_share.append(lambda run: 1.0 + excess * np.exp(-run.time / time_constant))
