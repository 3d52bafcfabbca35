"""Forced convection: housing-to-ambient conductance G (1 + c |w|)."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class ForcedConvection(Effect):
    """Conductance that grows with speed."""

    name = "forced_convection"
    one_sided = True

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the heat that leaves the housing in addition to the model's, per relative growth."""
        if (
            signals.housing is None
            or signals.ambient is None
            or signals.model.thermal is None
            or signals.velocity is None
        ):
            return {}
        model_heat = (signals.housing - signals.ambient) / signals.model.thermal.housing_ambient_resistance
        return {"housing_heat": {"coefficient": -model_heat * np.abs(signals.velocity)}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the relative growth per speed."""
        return {"coefficient": coefficients["coefficient"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a conductance that grows with speed."""
        coefficient = parameters["coefficient"]
        plant.convection.append(lambda rise, speed: coefficient * speed)
