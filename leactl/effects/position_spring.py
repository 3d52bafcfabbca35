"""Position spring: k x / sqrt(1 + (x / reach)^2) against the joint, x being its angle from where the spring rests."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Array, Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class PositionSpring(Effect):
    """A cable that pulls back, ever harder or up to what makes it slip."""

    name = "position_spring"
    # reach, from a cable that soon slips to a spring all along, and the rest that columns are made about
    forms = ((0.03, 0.0), (0.1, 0.0), (0.3, 0.0), (1.0, 0.0), (30.0, 0.0))
    form_scales = ("travel",)
    one_sided = True

    def applies(self, model: Model) -> bool:
        """A pendulum's servo is judged by free runs, which know no spring. A bench's shaft has no cable."""
        return model.load.type != "pendulum" and model.bench.shaft_stiffness is None

    def terms(self, signals: Signals, form: Form) -> Terms:
        """The pull of a spring that rests at the form's angle, and what it changes by as the rest moves."""
        if signals.angle is None or signals.mechanical != "free":
            return {}
        reach, rest = form
        away = signals.angle - rest
        bent = 1.0 + (away / reach) ** 2
        # coefficients go by name: the one that is the effect's size has to come first
        return {"drag": {"pull": away / np.sqrt(bent), "rest": -(bent**-1.5)}}

    def is_distinct(self, form: Form, coefficients: Mapping[str, float], visited: tuple[float, float]) -> bool:
        """A spring that no run takes through its rest pulls one way, as a constant torque does."""
        low, high = ((angle - form[1]) * coefficients["pull"] for angle in visited)
        return low <= coefficients["rest"] <= high

    def about(self, form: Form, coefficients: Mapping[str, float]) -> Form:
        """Columns about the rest that was found."""
        return form[0], self._rest(form, coefficients)

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Stiffness, rest and reach."""
        return {"stiffness": coefficients["pull"], "rest_angle": self._rest(form, coefficients), "reach": form[0]}

    def _rest(self, form: Form, coefficients: Mapping[str, float]) -> float:
        """Angle [rad] at which it does not pull."""
        stiffness = coefficients["pull"]
        return form[1] + (coefficients["rest"] / stiffness if stiffness else 0.0)

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """A torque over the angle."""
        stiffness, rest = parameters["stiffness"], parameters["rest_angle"]
        reach = parameters.get("reach", np.inf)

        def pull(angle: Array) -> Array:
            away = angle - rest
            return np.asarray(stiffness * away / np.sqrt(1.0 + (away / reach) ** 2), np.float64)

        plant.rotor_torque.append(lambda now: -pull(now.angle))
