"""Friction f + c |torque on the shaft|."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Array, Effect, Form, Signals, Terms
from leactl.effects.hysteresis_and_lags import stuck_between
from leactl.effects.plant import Plant
from leactl.model.nominal import Model

LEAST_LOCKED_FORM = 0.01  # replaces a form of zero for a locked rotor, whose column is divided by the form


class LoadDependentFriction(Effect):
    """Friction that grows with the transmitted torque."""

    name = "load_dependent_friction"
    one_sided = True
    # coefficients that are assumed in the column for the transmitted torque, which the effect itself changes
    forms = ((0.0,), (0.03,), (0.06,), (0.09,), (0.12,), (0.15,), (0.18,), (0.22,))
    continuous = False

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return a drag in proportion to shaft torque."""
        if signals.mechanical == "locked":
            current = signals.extra.get("sharp_current", signals.current)
            if current is None:
                return {}
            hidden_torque = hidden_locked_torque(current, signals.model, form[0] or LEAST_LOCKED_FORM)
            return {"drag": {"coefficient": hidden_torque}}
        if signals.sliding is None or signals.velocity is None or signals.torque is None:
            return {}
        # the effect itself reduces a driving torque and increases a braking one
        carried_torque = np.abs(signals.torque) / (1.0 + form[0] * np.sign(signals.torque * signals.velocity))
        return {"drag": {"coefficient": signals.sliding * carried_torque}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the friction per torque."""
        return {"coefficient": coefficients["coefficient"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add Coulomb friction in proportion to shaft torque."""
        coefficient = parameters["coefficient"]
        plant.coulomb_added.append(lambda now: coefficient * np.abs(now.transmitted))


def hidden_locked_torque(current: Array, model: Model, coefficient: float) -> Array:
    """Return the torque that a locked rotor hides in addition to the model's friction, per coefficient.

    Rising levels lose a share of the torque and falling levels keep it. Their mean changes by c^2, which in a model
    without this effect looks like a gain of the torque sensor.
    """
    motor_torque = (model.torque_constant or 0.0) * current
    friction, sign = model.coulomb_friction or 0.0, np.sign
    low = (motor_torque - friction) / (1.0 + coefficient * sign(motor_torque - friction))
    high = (motor_torque + friction) / (1.0 - coefficient * sign(motor_torque + friction))
    return (stuck_between(motor_torque - friction, motor_torque + friction) - stuck_between(low, high)) / coefficient
