"""Current sensor gain: reading g times current."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class CurrentSensorGain(Effect):
    """A measured current that is scaled wrongly."""

    name = "current_sensor_gain"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """The measured current, and the heat of the current that is not there."""
        if signals.current is not None:
            return {"current_reading": {"excess": signals.current}}
        heat = signals.extra.get("heat")
        if heat is not None and signals.mechanical != "heated":
            return {"winding_heat": {"excess": -2.0 * heat}}
        return {}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Gain."""
        return {"gain": 1.0 / max(1.0 - coefficients["excess"], 1e-3)}

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """Relative error."""
        return abs(coefficients["excess"])

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """A sensor whose reading the loop regulates."""
        plant.current_gain *= parameters["gain"]
