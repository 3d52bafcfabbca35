"""Stribeck friction: f (1 + r exp(-(|w| / v)^n)) instead of f, n = 1 (Tustin) or 2 (Gauss)."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class Stribeck(Effect):
    """Excess friction near zero speed."""

    name = "stribeck"
    relative_to = ("coulomb_friction",)
    one_sided = True
    forms = tuple((speed, shape) for shape in (1.0, 2.0) for speed in (0.0035, 0.009, 0.02, 0.045, 0.1))
    form_scales = ("highest speed",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return a drag that falls with speed; none for a locked rotor, whose encoder shows no speed."""
        if (
            signals.mechanical == "locked"
            or signals.sliding is None
            or signals.velocity is None
            or signals.model.coulomb_friction is None
        ):
            return {}
        decay = np.exp(-((np.abs(signals.velocity) / form[0]) ** form[1]))
        return {"drag": {"ratio": signals.model.coulomb_friction * signals.sliding * decay}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return ratio, speed and shape."""
        return {"breakaway_ratio": coefficients["ratio"], "stribeck_velocity": form[0], "shape": form[1]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a factor on friction that falls with speed."""
        ratio, velocity = parameters["breakaway_ratio"], parameters["stribeck_velocity"]
        shape = parameters.get("shape", 1.0)
        plant.coulomb_share.append(lambda now: 1.0 + ratio * np.exp(-((np.abs(now.velocity) / velocity) ** shape)))
