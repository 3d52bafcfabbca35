"""Emissivity: the camera reads Ta + e (T - Ta)."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model

LEAST_INVERSE_FRACTION = 0.05  # smallest inverse of the fraction; a fit that is linear in it may give zero or less


class EmissivityBias(Effect):
    """A camera that reads a fixed fraction of the rise."""

    name = "emissivity_bias"

    def applies(self, model: Model) -> bool:
        """Return whether the resistance depends on temperature: nothing else contradicts a camera's scale."""
        return model.resistance_coefficient > 0.0

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the rise that the camera misses, and voltages and heat of the winding's resistance at this rise."""
        if signals.winding is None or signals.ambient is None:
            return {}
        terms: Terms = {"camera_rise": {"excess": np.ones_like(signals.time)}}
        model = signals.model
        if model.phase_resistance is not None:
            resistance_change = (
                -model.phase_resistance * model.resistance_coefficient * (signals.winding - signals.ambient)
            )
            if signals.current is not None:
                terms["voltage"] = {"excess": resistance_change * signals.current}
            current_squared = signals.extra.get("current_squared")
            if current_squared is not None and signals.line_current is None:
                terms["winding_heat"] = {"excess": resistance_change * current_squared}
            if signals.line_current is not None:
                terms["line_voltage"] = {"excess": 2.0 * resistance_change * signals.line_current}
        return terms

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the fraction; the columns are linear in its inverse, since they contain the camera's reading."""
        return {"fraction": 1.0 / max(1.0 - coefficients["excess"], LEAST_INVERSE_FRACTION)}

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """Return the relative error."""
        return abs(coefficients["excess"])

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a camera that reads a fraction of the rise."""
        plant.camera_fraction *= parameters["fraction"]
