"""Cogging: a torque A sin(n angle + phase) on the rotor, without current."""

import math
from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Array, Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class Cogging(Effect):
    """Torque of teeth and magnets, periodic in angle."""

    name = "cogging"
    forms = ()
    periodic = "drag"
    orders = (2, 250)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return sine and cosine of the angle times each order, as torque that drives the rotor."""
        if signals.angle is None:
            return {}
        waves: dict[str, Array] = {}
        for index, order in enumerate(form):
            suffix = f"_{order:g}" if index else ""
            cosine, sine = signals.waves(order)
            waves |= {f"cos{suffix}": -cosine, f"sin{suffix}": -sine}
        return {"drag": waves}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return amplitude, order and phase of the first order; further orders are further entries of a model file."""
        amplitude = math.hypot(coefficients["cos"], coefficients["sin"])
        return {"amplitude": amplitude, "order": form[0], "phase": math.atan2(coefficients["cos"], coefficients["sin"])}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a torque over the angle."""
        amplitude, order, phase = (parameters[name] for name in ("amplitude", "order", "phase"))
        plant.rotor_torque.append(lambda now: amplitude * np.sin(order * now.angle + phase))
