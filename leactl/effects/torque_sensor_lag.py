"""Torque sensor lag: a further first-order lag of the torque channel."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.hysteresis_and_lags import lagged
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class TorqueSensorLag(Effect):
    """A torque channel that follows late."""

    name = "torque_sensor_lag"
    one_sided = True
    shaped = True
    forms = ((0.8,), (1.7,), (3.6,), (7.5,), (15.0,), (27.0,))
    form_scales = ("torque filter",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the change of the model's torque by the lag."""
        if signals.calm_torque is None or signals.mechanical == "free":
            return {}
        lagged_torque = lagged(signals.calm_torque, form[0], signals.interval)
        return {"torque_reading": {"strength": lagged_torque - signals.calm_torque}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the time constant."""
        return {"time_constant": form[0] * coefficients["strength"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a lag of the torque channel."""
        time_constant = parameters["time_constant"]
        plant.torque_reading.append(lambda run, reading: lagged(reading, time_constant, run.interval))
