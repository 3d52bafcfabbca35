"""Backlash: the shaft twists by half the play more, in the sense of the torque it carries."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class Backlash(Effect):
    """Free play between actuator and shaft."""

    name = "backlash"
    continuous = False
    one_sided = True
    explains = 0.45  # how fast the play is crossed depends on both rotors
    forms = ((0.25,), (1.5,))
    form_scales = ("friction",)

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return a twist that changes side with the torque.

        Torques do not show the sample at which two turning rotors cross the play, so that such runs give too small a
        width. They have another coefficient than locked runs.
        """
        if signals.torque is None or signals.mechanical not in ("coupled", "locked"):
            return {}
        flank = 0.5 * np.tanh(signals.torque / form[0])
        return {"twist": {"width" if signals.mechanical == "locked" else "crossed": flank}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the whole width, from locked runs where there are any."""
        return {"width": coefficients.get("width", coefficients.get("crossed", 0.0))}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add play in series with the shaft."""
        plant.play += parameters["width"]
