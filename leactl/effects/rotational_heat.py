"""Rotational heat: a share of b w^2 + f |w| warms the housing."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class RotationalHeat(Effect):
    """Friction that warms the machine."""

    name = "rotational_heat"
    one_sided = True

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the friction power, as heat of the housing."""
        if (
            signals.housing is None
            or signals.ambient is None
            or signals.model.thermal is None
            or signals.velocity is None
        ):
            return {}
        power = (signals.model.viscous_damping or 0.0) * signals.velocity**2
        power = power + (signals.model.coulomb_friction or 0.0) * np.abs(signals.velocity)
        return {"housing_heat": {"fraction": power}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the share of the friction power."""
        return {"fraction": coefficients["fraction"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add heat of the housing at a speed."""
        fraction, model = parameters["fraction"], plant.model
        damping, friction = model.viscous_damping or 0.0, model.coulomb_friction or 0.0
        plant.housing_heat.append(lambda speed: fraction * (damping * speed + friction) * speed)
