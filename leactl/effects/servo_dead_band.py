"""Dead band of a servo: an error within it gives no output."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class ServoDeadBand(Effect):
    """A controller that leaves small errors alone; judged by free runs, not by equations."""

    name = "servo_dead_band"
    one_sided = True

    def applies(self, model: Model) -> bool:
        """Return whether a position servo drives the model."""
        return model.drive is not None

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return no terms: the effect is judged by simulation."""
        return {}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return half the width of the band."""
        return {"band": coefficients["band"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a dead band of the servo's error."""
        band = parameters["band"]
        plant.servo_error.append(lambda error: np.where(np.abs(error) < band, 0.0, error))
