"""Coulomb friction f (1 + a cos(n angle + phase))."""

import math
from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class PositionDependentFriction(Effect):
    """Friction that varies over a turn."""

    name = "position_dependent_friction"
    relative_to = ("coulomb_friction",)
    continuous = False
    orders = (1, 12)
    forms = tuple((float(order),) for order in range(orders[0], orders[1] + 1))

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return a drag with the sign of the motion, periodic in angle."""
        if (
            signals.sliding is None
            or signals.angle is None
            or signals.model.coulomb_friction is None
            or signals.mechanical == "locked"
        ):
            return {}
        sliding = signals.model.coulomb_friction * signals.sliding
        cosine, sine = signals.waves(form[0])
        return {"drag": {"cos": sliding * cosine, "sin": sliding * sine}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return amplitude, order and phase."""
        amplitude = math.hypot(coefficients["cos"], coefficients["sin"])
        return {
            "amplitude": amplitude,
            "order": form[0],
            "phase": math.atan2(-coefficients["sin"], coefficients["cos"]),
        }

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a factor on friction over the angle."""
        amplitude, order, phase = (parameters[name] for name in ("amplitude", "order", "phase"))
        plant.coulomb_share.append(lambda now: 1.0 + amplitude * np.cos(order * now.angle + phase))
