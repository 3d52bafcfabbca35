"""Time skew: the torque stream is stamped late by a fixed time."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.hysteresis_and_lags import delayed
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class TimeSkew(Effect):
    """A torque stream that is late."""

    name = "time_skew"
    one_sided = True
    shaped = True
    delays = True
    forms = ((0.8,), (1.7,), (3.6,), (7.6,), (16.0,), (33.0,), (50.0,))
    form_scales = ("torque filter",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the change of the model's torque by the delay."""
        if signals.calm_torque is None or signals.mechanical == "free":
            return {}
        delayed_torque = delayed(signals.calm_torque, form[0], signals.interval)
        return {"torque_reading": {"strength": delayed_torque - signals.calm_torque}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the delay."""
        return {"delay": form[0] * coefficients["strength"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a delay of the torque channel."""
        delay = parameters["delay"]
        plant.torque_reading.append(lambda run, reading: delayed(reading, delay, run.interval))
