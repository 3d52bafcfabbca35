"""Transport delay: current follows what the loop makes of its reference a time later."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.hysteresis_and_lags import delayed
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class TransportDelay(Effect):
    """Current that follows late."""

    name = "transport_delay"
    one_sided = True
    shaped = True
    delays = True
    forms = ((1.5,), (3.1,), (6.4,), (13.0,), (25.0,))
    form_scales = ("loop",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the change of the model's current by the delay."""
        if signals.following is None:
            return {}
        delayed_current = delayed(signals.following, form[0], signals.interval)
        return {"current_following": {"strength": delayed_current - signals.following}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the delay."""
        return {"delay": form[0] * coefficients["strength"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a delay of the current loop's response."""
        delay = parameters["delay"]
        plant.loop_answer.append(lambda values, interval: delayed(values, delay, interval))
