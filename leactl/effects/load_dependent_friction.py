"""Friction f + c |torque on the shaft|."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class LoadDependentFriction(Effect):
    """Friction that grows with what is transmitted."""

    name = "load_dependent_friction"
    one_sided = True
    forms = ((0.0,), (0.03,), (0.08,), (0.15,), (0.25,))  # how much of it the model's torque already has to do without
    continuous = False

    def terms(self, signals: Signals, form: Form) -> Terms:
        """A drag in proportion to shaft torque."""
        if (
            signals.sliding is None
            or signals.velocity is None
            or signals.torque is None
            or signals.mechanical == "locked"
        ):
            return {}
        # the friction itself takes from a torque that drives and adds to one that brakes
        carried = np.abs(signals.torque) / (1.0 + form[0] * np.sign(signals.torque * signals.velocity))
        return {"drag": {"coefficient": signals.sliding * carried}}

    def parameters(self, form: Form, found: Mapping[str, float], model: Model) -> dict[str, float]:
        """Friction per torque."""
        return {"coefficient": found["coefficient"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Coulomb friction in proportion to shaft torque."""
        coefficient = parameters["coefficient"]
        plant.coulomb_added.append(lambda now: coefficient * np.abs(now.transmitted))
