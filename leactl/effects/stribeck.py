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
        """A drag that fades with speed; a locked rotor turns by less than its encoder tells a speed of."""
        if (
            signals.mechanical == "locked"
            or signals.sliding is None
            or signals.velocity is None
            or signals.model.coulomb_friction is None
        ):
            return {}
        fading = np.exp(-((np.abs(signals.velocity) / form[0]) ** form[1]))
        return {"drag": {"ratio": signals.model.coulomb_friction * signals.sliding * fading}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Ratio and speed."""
        return {"breakaway_ratio": coefficients["ratio"], "stribeck_velocity": form[0], "shape": form[1]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """A factor that fades with speed."""
        ratio, fading = parameters["breakaway_ratio"], parameters["stribeck_velocity"]
        shape = parameters.get("shape", 1.0)
        plant.coulomb_share.append(lambda now: 1.0 + ratio * np.exp(-((np.abs(now.velocity) / fading) ** shape)))
