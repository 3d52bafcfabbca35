"""Damping and Coulomb friction times 1 + c (T - T0), T at the housing."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.model_friction import friction_torque
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class FrictionTemperature(Effect):
    """Friction that changes with temperature."""

    name = "friction_temperature"
    relative_to = ("coulomb_friction", "viscous_damping")

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the nominal friction times the housing's rise."""
        if (
            signals.sliding is None
            or signals.velocity is None
            or signals.model.coulomb_friction is None
            or signals.housing_rise is None
        ):
            return {}
        friction = friction_torque(signals.model, signals.velocity, signals.sliding)
        return {"drag": {"coefficient": friction * signals.housing_rise}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the relative change per kelvin."""
        return {"coefficient": coefficients["coefficient"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add friction that changes with the housing's temperature."""
        coefficient, reference = parameters["coefficient"], plant.model.reference_temperature
        plant.friction_share.append(lambda run: 1.0 + coefficient * (run.housing - reference))
