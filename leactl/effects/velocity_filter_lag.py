"""Velocity lag: a further first-order lag of the reported velocity."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.hysteresis_and_lags import lagged
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class VelocityFilterLag(Effect):
    """A velocity that lags beyond the model's filter."""

    name = "velocity_filter_lag"
    one_sided = True
    shaped = True
    forms = ((1.0,), (2.1,), (4.4,), (9.2,), (19.0,), (39.0,), (80.0,))
    form_scales = ("velocity filter",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the change of the model's velocity by the lag."""
        if signals.calm_velocity is None or signals.angle is None:
            return {}
        lagged_velocity = lagged(signals.calm_velocity, form[0], signals.interval)
        return {"velocity_reading": {"strength": lagged_velocity - signals.calm_velocity}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the time constant."""
        return {"time_constant": form[0] * coefficients["strength"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a lag of the velocity channel."""
        time_constant = parameters["time_constant"]
        plant.velocity_reading.append(lambda values, interval: lagged(values, time_constant, interval))
