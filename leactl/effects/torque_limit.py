"""Torque limit: the current is the model's, cut off at a largest current."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class TorqueLimit(Effect):
    """A drive that gives no more than a certain current."""

    name = "torque_limit"
    one_sided = True
    shaped = True
    limits_current = True
    forms = ((0.3,), (0.4,), (0.5,), (0.6,), (0.7,), (0.8,), (0.9,))
    form_scales = ("highest current",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the change of the model's current by the limit."""
        if signals.following is None:
            return {}
        limited_current = np.clip(signals.following, -form[0], form[0])
        return {"current_following": {"strength": limited_current - signals.following}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the largest current."""
        return {"current": form[0]}

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """Return the fitted share of the limit."""
        return abs(coefficients["strength"])

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a limit of the command."""
        limit = parameters["current"]
        plant.command.append(lambda values, interval: np.clip(values, -limit, limit))

    def whole(self, form: Form, strength: float) -> Form:
        """Return the form unchanged: half the effect of a limit is not that of a limit at another current."""
        return form
