"""Shaft compliance: twist torque / k with k much below the model's."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class ShaftCompliance(Effect):
    """A shaft or sensor softer than the model's."""

    name = "shaft_compliance"
    one_sided = True

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the twist by the model's stiffness."""
        if signals.torque is None or signals.model.bench.shaft_stiffness is None:
            return {}
        return {"twist": {"excess": signals.torque / signals.model.bench.shaft_stiffness}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the stiffness."""
        assert model.bench.shaft_stiffness is not None
        return {"stiffness": model.bench.shaft_stiffness / max(1.0 + coefficients["excess"], 1e-3)}

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """Return the relative excess of the compliance."""
        return abs(coefficients["excess"])

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Replace the shaft's stiffness."""
        plant.stiffness = parameters["stiffness"]
