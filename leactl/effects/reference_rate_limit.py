"""Limited reference: a servo's own set-point goes to what it is asked for at a limited speed and acceleration."""

import math
from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Array, Plant
from leactl.effects.shapes import rate_limited
from leactl.model.nominal import Model


class ReferenceRateLimit(Effect):
    """A trapezoidal profile between a servo's reference and its controller; judged by free runs, not by equations."""

    name = "reference_rate_limit"
    one_sided = True

    def applies(self, model: Model) -> bool:
        """A servo's alone."""
        return model.drive is not None

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Nothing: what a set-point does shows where runs are simulated."""
        return {}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Speed."""
        return {"speed": coefficients["speed"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """A set-point that goes to its reference no faster than the limits allow."""
        speed, acceleration = parameters["speed"] or math.inf, parameters.get("acceleration", 0.0)
        if acceleration:
            plant.set_point.append(lambda values, interval: trapezoidal(values, speed, acceleration, interval))
        elif math.isfinite(speed):
            plant.set_point.append(lambda values, interval: rate_limited(values, speed * interval))


def trapezoidal(values: Array, speed: float, acceleration: float, interval: float) -> Array:
    """What goes to values with no more than a speed and an acceleration, and slows down so that it stops there."""
    point, pace, out = float(values[0]), 0.0, []
    gain = acceleration * interval
    for value in values.tolist():
        left = (value - point) / interval
        # the fastest from which equal steps of braking end at the value
        most = min(gain * (math.sqrt(0.25 + 2.0 * abs(left) / gain) - 0.5), abs(left), speed)
        wanted = math.copysign(most, left)
        pace += min(max(wanted - pace, -gain), gain)
        point += pace * interval
        out.append(point)
    return np.array(out, np.float64)
