"""Ambient drift: the true ambient moves away from the logged one, as a power of time."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class AmbientDrift(Effect):
    """A true ambient that moves away from the logged one."""

    name = "ambient_drift"
    forms = ((0.5,), (1.0,), (2.0,))
    continuous = False

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the heat that a warmer ambient keeps in winding and housing, per kelvin of change in two hours."""
        if signals.housing is None or signals.ambient is None or signals.model.thermal is None:
            return {}
        share = (signals.time / 7200.0) ** form[0]
        network = signals.model.thermal
        return {
            "housing_heat": {"change": share / network.housing_ambient_resistance},
            "winding_heat": {"change": share / network.winding_ambient_resistance},
        }

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the change in two hours, and the power of time."""
        return {"change": coefficients["change"], "shape": form[0]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add an ambient that changes with a power of time."""
        change, shape = parameters["change"], parameters.get("shape", 1.0)
        plant.ambient_change.append(lambda time: change * (time / 7200.0) ** shape)
