"""Torque sensor hysteresis: the reading follows torque with play."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.hysteresis_and_lags import play
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class TorqueSensorHysteresis(Effect):
    """A reading that depends on where it comes from."""

    name = "torque_sensor_hysteresis"
    one_sided = True
    forms = ((0.01,), (0.05,), (0.2,))

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the change of the model's torque by play, per share of the run's largest torque."""
        if signals.torque is None or signals.mechanical == "free":
            return {}
        largest_torque = float(np.max(np.abs(signals.torque)))
        if largest_torque == 0.0:
            return {}
        change = (play(signals.torque, form[0] * largest_torque) - signals.torque) / form[0]
        return {"torque_reading": {"width": change}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the half width over the run's largest torque."""
        return {"width": coefficients["width"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add play of the reading, as a share of the run's largest torque."""
        width = parameters["width"]
        plant.torque_reading.append(lambda run, reading: play(reading, width * float(np.max(np.abs(reading)))))
