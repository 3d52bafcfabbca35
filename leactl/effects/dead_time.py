"""Dead time: a voltage U tanh(i / i0) lost in the inverter at a current i; it saturates at the current i0 [A]."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class DeadTime(Effect):
    """Inverter voltage error with the sign of the current."""

    name = "dead_time"
    one_sided = True
    # saturating current, as shares of the highest current
    forms = ((0.003,), (0.008,), (0.02,), (0.05,))
    form_scales = ("highest current",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the share of the lost voltage at each current, between -1 and 1."""
        if signals.current is None:
            return {}
        return {"voltage": {"voltage": np.tanh(signals.current / form[0])}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the lost voltage, and the current at which it saturates."""
        return {"voltage": coefficients["voltage"], "current": form[0]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a loss of voltage between drive and winding."""
        lost_voltage, saturating_current = parameters["voltage"], parameters["current"]
        plant.lost_voltage.append(lambda current: lost_voltage * np.tanh(current / saturating_current))
