"""Third node: a heat capacity C behind a resistance R hangs on the housing."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.hysteresis_and_lags import lagged
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class ThirdThermalNode(Effect):
    """A further heat capacity."""

    name = "third_thermal_node"
    one_sided = True
    forms = ((0.4,), (1.25,), (4.0,), (12.0,))
    form_scales = ("housing",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the heat from a body that follows the housing with the time constant R C, per conductance."""
        if signals.housing is None or signals.ambient is None or signals.model.thermal is None:
            return {}
        body_temperature = lagged(signals.housing, form[0], signals.interval)
        columns = {"conductance": body_temperature - signals.housing}
        if signals.mechanical != "heated":
            # the temperature of the body at the start of a run that begins warm is not known
            columns[f"start of {signals.run}"] = np.exp(-signals.time / form[0])
        return {"housing_heat": columns}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return capacitance and resistance."""
        conductance = max(coefficients["conductance"], 1e-9)
        return {"capacitance": form[0] * conductance, "resistance": 1.0 / conductance}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a body behind the housing."""
        plant.further_node = (parameters["capacitance"], parameters["resistance"])
