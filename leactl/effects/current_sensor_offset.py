"""Current sensor offset: reading current + c."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class CurrentSensorOffset(Effect):
    """A measured current with a wrong zero."""

    name = "current_sensor_offset"

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return a constant, or the heat that the model computes in excess from a measured current."""
        if signals.current is not None or "commanded" in signals.extra:  # a commanded force has the current's zero
            return {"current_reading": {"offset": np.ones_like(signals.time)}}
        heat_per_ampere = signals.extra.get("heat_per_ampere")
        return {"winding_heat": {"offset": -heat_per_ampere}} if heat_per_ampere is not None else {}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the offset."""
        return {"offset": coefficients["offset"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add an offset of the reading that the current loop regulates."""
        plant.current_offset += parameters["offset"]
