"""Winding resistance R (1 + c (T - T0)) where the model has c = 0."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class ResistanceTemperature(Effect):
    """Resistance that rises with temperature."""

    name = "resistance_temperature"
    one_sided = True

    def applies(self, model: Model) -> bool:
        """Return whether the model's coefficient is zero; any other coefficient is a parameter of the model."""
        return model.resistance_coefficient == 0.0

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the voltage over the added resistance, of the drive or of the heated leads, and its heat."""
        if signals.winding_rise is None or signals.model.phase_resistance is None:
            return {}
        terms: Terms = {}
        if signals.current is not None:
            added_voltage = signals.model.phase_resistance * signals.winding_rise * signals.current
            terms["voltage"] = {"coefficient": added_voltage}
        if signals.line_current is not None:
            rise = signals.extra.get("fed_rise", signals.winding_rise)  # of the phases that two leads feed
            added_voltage = 2.0 * signals.model.phase_resistance * rise * signals.line_current
            terms["line_voltage"] = {"coefficient": added_voltage}
        elif "heat" in signals.extra:
            terms["winding_heat"] = {"coefficient": signals.extra["heat"] * signals.winding_rise}
        return terms

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the relative change per kelvin."""
        return {"coefficient": coefficients["coefficient"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a coefficient of the resistance."""
        plant.resistance_coefficient += parameters["coefficient"]
