"""Coulomb friction of f (1 + a) forward and f (1 - a) backward."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.model.nominal import Model


class AsymmetricFriction(Effect):
    """Friction that differs by direction."""

    name = "asymmetric_friction"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """A constant drag while the shaft turns."""
        if signals.sliding is None or signals.model.coulomb_friction is None or signals.mechanical == "locked":
            return {}
        return {"drag": {"asymmetry": signals.model.coulomb_friction * np.abs(signals.sliding)}}

    def parameters(self, form: Form, found: Mapping[str, float], model: Model) -> dict[str, float]:
        """Half the difference over the mean."""
        return {"asymmetry": found["asymmetry"]}
