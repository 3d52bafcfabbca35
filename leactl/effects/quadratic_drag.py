"""Drag c w |w|."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class QuadraticDrag(Effect):
    """Drag with the square of speed."""

    name = "quadratic_drag"
    one_sided = True

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return a drag with the square of the speed."""
        if signals.velocity is None:
            return {}
        return {"drag": {"coefficient": signals.velocity * np.abs(signals.velocity)}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the drag per squared speed."""
        return {"coefficient": coefficients["coefficient"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a drag with the square of the speed."""
        coefficient = parameters["coefficient"]
        plant.drag.append(lambda now: coefficient * now.velocity * np.abs(now.velocity))
