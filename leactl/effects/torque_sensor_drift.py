"""Torque sensor drift: a zero that moves by a rate from the start of a run."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class TorqueSensorDrift(Effect):
    """A zero that moves with time."""

    name = "torque_sensor_drift"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the time since the run's start, to which the reading's error is proportional."""
        if signals.torque is None or signals.mechanical == "free":
            return {}
        return {"torque_reading": {"rate": signals.time}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the rate."""
        return {"rate": coefficients["rate"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a zero that moves with time."""
        rate = parameters["rate"]
        plant.torque_reading.append(lambda run, reading: reading + rate * run.time)
