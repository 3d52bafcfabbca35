"""Current sensor gain: reading g times current."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class CurrentSensorGain(Effect):
    """A measured current that is scaled wrongly."""

    name = "current_sensor_gain"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the measured current, or the heat that the model computes in excess from a measured current."""
        if signals.current is not None:
            return {"current_reading": {"excess": signals.current}}
        heat = signals.extra.get("heat")
        if heat is not None and signals.mechanical != "heated":
            return {"winding_heat": {"excess": -2.0 * heat}}
        return {}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the gain."""
        return {"gain": 1.0 / max(1.0 - coefficients["excess"], 1e-3)}

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """Return the relative error."""
        return abs(coefficients["excess"])

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a gain of the reading that the current loop regulates."""
        plant.current_gain *= parameters["gain"]
