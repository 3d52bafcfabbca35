"""Magnets: torque and back-EMF constants times 1 - c (T - T0)."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class MagnetTemperature(Effect):
    """Constants that fall with temperature."""

    name = "magnet_temperature"
    continuous = False
    one_sided = True
    forms = ((0.0,), (1.0,))

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return an equal relative loss of both constants, in proportion to the housing's or the winding's rise."""
        if signals.housing_rise is None or signals.winding_rise is None:
            return {}
        rise = signals.winding_rise if form[0] else signals.housing_rise
        return {"torque_factor": {"coefficient": -rise}, "emf_factor": {"coefficient": -rise}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the relative loss per kelvin."""
        return {"coefficient": coefficients["coefficient"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a change of both constants with the housing's temperature."""
        coefficient, reference = parameters["coefficient"], plant.model.reference_temperature
        plant.magnet_share.append(lambda run: 1.0 - coefficient * (run.housing - reference))
