"""Limited reference: a servo's own set-point goes to what it is asked for at a limited speed and acceleration."""

import math
from collections.abc import Mapping

import numpy as np

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.hysteresis_and_lags import rate_limited
from leactl.effects.plant import Array, Plant
from leactl.model.nominal import Model


class ReferenceRateLimit(Effect):
    """A trapezoidal profile between a servo's reference and its controller; judged by free runs, not by equations."""

    name = "reference_rate_limit"
    one_sided = True

    def applies(self, model: Model) -> bool:
        """Return whether a position servo drives the model."""
        return model.drive is not None

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return no terms: the effect is judged by simulation."""
        return {}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the speed limit."""
        return {"speed": coefficients["speed"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a set-point that follows its reference within the limits."""
        speed, acceleration = parameters["speed"] or math.inf, parameters.get("acceleration", 0.0)
        if acceleration:
            plant.set_point.append(lambda values, interval: trapezoidal(values, speed, acceleration, interval))
        elif math.isfinite(speed):
            plant.set_point.append(lambda values, interval: rate_limited(values, speed * interval))


def trapezoidal(values: Array, speed: float, acceleration: float, interval: float) -> Array:
    """Return the profile that follows values with limited speed and acceleration, and stops at each value."""
    point, current_speed, profile = float(values[0]), 0.0, []
    gain = acceleration * interval
    for value in values.tolist():
        needed_speed = (value - point) / interval
        # the highest speed from which equal steps of braking end at the value
        highest = min(gain * (math.sqrt(0.25 + 2.0 * abs(needed_speed) / gain) - 0.5), abs(needed_speed), speed)
        target_speed = math.copysign(highest, needed_speed)
        current_speed += min(max(target_speed - current_speed, -gain), gain)
        point += current_speed * interval
        profile.append(point)
    return np.array(profile, np.float64)
