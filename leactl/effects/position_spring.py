"""Position spring: k x / sqrt(1 + (x / reach)^2) against the joint, x being its angle from where the spring rests."""

from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Array, Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class PositionSpring(Effect):
    """A cable that pulls back, in proportion to the angle or up to a force at which it slips."""

    name = "position_spring"
    # reach, from a cable that soon slips to a linear spring, and the rest angle about which columns are linearised
    forms = ((0.03, 0.0), (0.1, 0.0), (0.3, 0.0), (1.0, 0.0), (30.0, 0.0))
    form_scales = ("travel",)
    one_sided = True

    def applies(self, model: Model) -> bool:
        """Return whether the joint has no pendulum, whose free runs include no spring, and no bench shaft."""
        return model.load.type != "pendulum" and model.bench.shaft_stiffness is None

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the torque of a spring at rest at the form's angle, and its derivative with that angle."""
        if signals.angle is None or signals.mechanical != "free":
            return {}
        reach, rest_angle = form
        deflection = signals.angle - rest_angle
        softening = 1.0 + (deflection / reach) ** 2
        # columns are sorted by the names of coefficients: that of the effect's size has to come first
        return {"drag": {"pull": deflection / np.sqrt(softening), "rest": -(softening**-1.5)}}

    def is_distinct(self, form: Form, coefficients: Mapping[str, float], visited: tuple[float, float]) -> bool:
        """Return whether some run passes the rest: else the spring pulls in one direction, as a constant torque."""
        low, high = ((angle - form[1]) * coefficients["pull"] for angle in visited)
        return low <= coefficients["rest"] <= high

    def about(self, form: Form, coefficients: Mapping[str, float]) -> Form:
        """Return the form with the fitted rest."""
        return form[0], self._rest(form, coefficients)

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return stiffness, rest angle and reach."""
        return {"stiffness": coefficients["pull"], "rest_angle": self._rest(form, coefficients), "reach": form[0]}

    def _rest(self, form: Form, coefficients: Mapping[str, float]) -> float:
        """Return the angle [rad] at which the spring does not pull."""
        stiffness = coefficients["pull"]
        return form[1] + (coefficients["rest"] / stiffness if stiffness else 0.0)

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a torque over the angle to the rotor."""
        stiffness, rest_angle = parameters["stiffness"], parameters["rest_angle"]
        reach = parameters.get("reach", np.inf)

        def pull(angle: Array) -> Array:
            deflection = angle - rest_angle
            return np.asarray(stiffness * deflection / np.sqrt(1.0 + (deflection / reach) ** 2), np.float64)

        plant.rotor_torque.append(lambda now: -pull(now.angle))
