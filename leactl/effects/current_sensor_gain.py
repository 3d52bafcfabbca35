"""Current sensor gain: reading g times current."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class CurrentSensorGain(Effect):
    """A measured current that is scaled wrongly."""

    name = "current_sensor_gain"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """The measured current."""
        if signals.current is None:
            return {}
        return {"current_reading": {"excess": signals.current}}

    def parameters(self, form: Form, found: Mapping[str, float], model: Model) -> dict[str, float]:
        """Gain."""
        return {"gain": 1.0 / max(1.0 - found["excess"], 1e-3)}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """A sensor whose reading the loop regulates."""
        plant.current_gain *= parameters["gain"]
