"""Presliding: friction builds up over an angle instead of at once (Dahl, 1968)."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.hysteresis_and_lags import bristle
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class Presliding(Effect):
    """Friction that lags behind a reversal."""

    name = "presliding"
    relative_to = ("coulomb_friction",)
    one_sided = True
    explains = 0.6  # the curve of bristles differs from one bearing to the next
    shaped = True
    forms = tuple((float(displacement),) for displacement in np.geomspace(0.0005, 0.02, 6))

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the difference from Coulomb friction while bristles bend; a locked rotor moves by its twist."""
        model = signals.model
        if model.coulomb_friction is None:
            return {}
        if signals.mechanical == "locked":
            if signals.torque is None or signals.current is None or model.bench.shaft_stiffness is None:
                return {}
            hidden_torque = (model.torque_constant or 0.0) * signals.current - signals.torque
            bristle_share = bristle(signals.torque / model.bench.shaft_stiffness, form[0])
            return {"drag": {"strength": model.coulomb_friction * bristle_share - hidden_torque}}
        if signals.sliding is None or signals.angle is None:
            return {}
        return {"drag": {"strength": model.coulomb_friction * (bristle(signals.angle, form[0]) - signals.sliding)}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the displacement, scaled by the fitted share of the column."""
        return {"displacement": form[0] * coefficients["strength"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add bristles that bend before they slide."""
        plant.bristle += parameters["displacement"]
