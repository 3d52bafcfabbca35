"""Power fold-back: the current is the model's, cut off where torque times speed would exceed a largest power."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Array, Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class PowerFoldback(Effect):
    """A drive that gives less current at speed."""

    name = "power_foldback"
    one_sided = True
    shaped = True
    limits_current = True
    forms = ((0.2,), (0.3,), (0.4,), (0.55,), (0.7,), (0.85,))
    form_scales = ("highest power",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the change of the model's current by the limit."""
        constant = signals.model.torque_constant
        if signals.following is None or signals.velocity is None or constant is None:
            return {}
        limited_current = folded_back(signals.following, signals.velocity, form[0] / constant)
        return {"current_following": {"strength": limited_current - signals.following}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the largest power."""
        return {"power": form[0]}

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """Return the fitted share of the limit."""
        return abs(coefficients["strength"])

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a limit of the command at the measured speed."""
        constant = plant.model.torque_constant
        if constant is not None:
            largest_product = parameters["power"] / constant
            plant.command_at_speed.append(lambda values, speed: folded_back(values, speed, largest_product))

    def whole(self, form: Form, strength: float) -> Form:
        """Return the form unchanged: half the effect of a limit is not that of a limit at another power."""
        return form


def folded_back(current: Array, velocity: Array, largest_product: float) -> Array:
    """Return the current [A], reduced so that its product with the speed stays within a bound [A*rad/s]."""
    return np.asarray(current * (largest_product / np.maximum(np.abs(current * velocity), largest_product)), np.float64)
