"""Coulomb friction of f (1 + a) forward and f (1 - a) backward."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class AsymmetricFriction(Effect):
    """Friction that differs by direction."""

    name = "asymmetric_friction"
    relative_to = ("coulomb_friction",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return a constant drag: f (sgn w + a), reversals included; rows of a resting shaft are not read."""
        if signals.sliding is None or signals.model.coulomb_friction is None or signals.mechanical == "locked":
            return {}
        return {"drag": {"asymmetry": np.full_like(signals.sliding, signals.model.coulomb_friction)}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the asymmetry: half the difference of forward and backward friction, over their mean."""
        return {"asymmetry": coefficients["asymmetry"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Multiply Coulomb friction by 1 + asymmetry forward and 1 - asymmetry backward."""
        asymmetry = parameters["asymmetry"]
        plant.coulomb_share.append(lambda now: 1.0 + asymmetry * np.sign(now.velocity))
