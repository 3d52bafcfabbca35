"""Torque sensor offset: reading torque + c."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class TorqueSensorOffset(Effect):
    """A torque channel with a wrong zero."""

    name = "torque_sensor_offset"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return a constant error of the reading."""
        if signals.torque is None or signals.mechanical == "free":
            return {}
        return {"torque_reading": {"offset": np.ones_like(signals.time)}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the offset."""
        return {"offset": coefficients["offset"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add an offset of the reading."""
        offset = parameters["offset"]
        plant.torque_reading.append(lambda run, reading: reading + offset)
