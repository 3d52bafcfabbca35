"""Torque ripple: a torque constant K (1 + a sin(n angle + phase))."""

import math
from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class TorqueRipple(Effect):
    """Torque periodic in angle, proportional to current."""

    name = "torque_ripple"
    forms = ()
    periodic = "torque_factor"
    orders = (2, 300)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return cosine and sine of the angle times the order, as relative changes of the torque."""
        if signals.angle is None or signals.current is None:
            return {}
        cosine, sine = signals.waves(form[0])
        return {"torque_factor": {"cos": cosine, "sin": sine}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return amplitude, order and phase."""
        amplitude = math.hypot(coefficients["cos"], coefficients["sin"])
        return {"amplitude": amplitude, "order": form[0], "phase": math.atan2(coefficients["cos"], coefficients["sin"])}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a relative change of the torque over the angle."""
        amplitude, order, phase = (parameters[name] for name in ("amplitude", "order", "phase"))
        plant.ripple.append(lambda now: amplitude * np.sin(order * now.angle + phase))
