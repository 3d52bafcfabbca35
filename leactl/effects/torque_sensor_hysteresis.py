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
        """What play on either side takes from the model's torque, as a share of the swing."""
        if signals.torque is None or signals.mechanical == "free":
            return {}
        swing = float(np.max(np.abs(signals.torque)))
        if swing == 0.0:
            return {}
        behind = (play(signals.torque, form[0] * swing) - signals.torque) / form[0]
        return {"torque_reading": {"width": behind}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Half width over the swing."""
        return {"width": coefficients["width"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """A reading that follows with play, a share of the run's swing."""
        width = parameters["width"]
        plant.torque_reading.append(lambda run, reading: play(reading, width * float(np.max(np.abs(reading)))))
