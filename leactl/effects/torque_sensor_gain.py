"""Torque sensor gain: reading g times torque."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class TorqueSensorGain(Effect):
    """A torque channel that is scaled wrongly."""

    name = "torque_sensor_gain"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the model's torque, to which the reading's error is proportional."""
        if signals.torque is None or signals.mechanical == "free":
            return {}
        return {"torque_reading": {"excess": signals.torque}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the gain."""
        return {"gain": 1.0 + coefficients["excess"]}

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """Return the relative error."""
        return abs(coefficients["excess"])

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a factor on the reading."""
        gain = parameters["gain"]
        plant.torque_reading.append(lambda run, reading: gain * reading)
