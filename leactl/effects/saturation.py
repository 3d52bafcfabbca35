"""Saturation: a torque constant K (1 - s (|i| / I)^p)."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class Saturation(Effect):
    """A torque constant that falls at high current."""

    name = "saturation"
    continuous = False
    one_sided = True
    forms = ((1.0, 1.0), (2.0, 1.0), (4.0, 1.0))
    form_scales = ("1", "highest current")

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return a relative loss that grows with current."""
        if signals.current is None:
            return {}
        return {"torque_factor": {"loss": -((np.abs(signals.current) / form[1]) ** form[0])}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the loss at a current, the exponent of its growth, and that current."""
        return {"loss": coefficients["loss"], "exponent": form[0], "current": form[1]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a torque constant that falls with a power of the current, the square by default."""
        loss, exponent, full_current = (
            parameters["loss"],
            parameters.get("exponent", 2.0),
            parameters.get("current", 25.0),
        )
        plant.torque_share.append(lambda current: 1.0 - loss * (np.abs(current) / full_current) ** exponent)
