"""Voltage limit: the command is clipped to the currents that supply voltage and back-EMF allow."""

import math
from collections.abc import Mapping
from itertools import product

import numpy as np

from leactl.effects.contract import Array, Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model

# largest share of the stall current that may be left at the highest speed of the runs; with more left, the no-load
# speed is above ten times the highest speed, and the limit resembles one of the current alone
MOST_LEFT_SHARE = 0.9


class VoltageLimit(Effect):
    """A drive at the end of its voltage.

    A voltage U drives the stall current U / R through a motor at rest, and none at the no-load speed U / K, K being the
    back-EMF constant. Between them the current falls in a straight line: the steady state, without inductance.
    """

    name = "voltage_limit"
    one_sided = True
    shaped = True
    limits_current = True
    refined = 2
    # Stall current, current left at the highest speed of the runs, and that speed, in units of `form_scales`. Runs near
    # that speed determine the current left well and the stall current badly; the no-load speed as the second number
    # would have the errors of both. The third number has one value and is never refined.
    forms = tuple(product((0.7, 1.0, 1.5, 2.5, 5.0, 10.0), (0.06, 0.085, 0.12, 0.17, 0.24, 0.34, 0.48, 0.68), (1.0,)))
    form_scales = ("highest current", "highest current", "highest speed")

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the change of the model's current by the limit."""
        if signals.command is None or signals.following is None or signals.velocity is None or signals.looped is None:
            return {}
        if form[1] > MOST_LEFT_SHARE * form[0]:  # the current hardly falls with speed, as by a torque limit
            return {}
        limited_command = within_voltage(signals.command, signals.velocity, form[0], no_load_speed_of(form))
        if np.array_equal(limited_command, signals.command):
            return {}
        response = signals.looped(limited_command, np.zeros_like(limited_command), float(limited_command[0]))
        return {"current_following": {"strength": response - signals.following}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return stall current and no-load speed."""
        return {"stall_current": form[0], "no_load_speed": no_load_speed_of(form)}

    def size(self, form: Form, coefficients: Mapping[str, float], model: Model) -> float:
        """Return the fitted share of the limit."""
        return abs(coefficients["strength"])

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a limit of the command by the voltage that back-EMF leaves at the measured speed."""
        stall_current, no_load_speed = parameters["stall_current"], parameters["no_load_speed"]
        plant.command_at_speed.append(lambda values, speed: within_voltage(values, speed, stall_current, no_load_speed))

    def whole(self, form: Form, strength: float) -> Form:
        """Return the form unchanged: half the effect of a limit is not that of a limit at another voltage."""
        return form


def no_load_speed_of(form: Form) -> float:
    """Return the no-load speed [rad/s] of a form; infinite if its limit does not fall with speed."""
    stall_current, remaining_current, speed = form
    return speed / (1.0 - remaining_current / stall_current) if remaining_current < stall_current else math.inf


def within_voltage(current: Array, velocity: Array, stall_current: float, no_load_speed: float) -> Array:
    """Return the commanded current [A], clipped to what the voltage can drive at this velocity [rad/s].

    At rest the bounds are plus and minus `stall_current` [A]. Both shift against the velocity in proportion to it, so
    that the upper bound is zero at `no_load_speed` [rad/s]. Above that speed the motor brakes even if no current is
    commanded.
    """
    back_emf_current = stall_current * velocity / no_load_speed  # A, K velocity / R
    return np.asarray(np.clip(current, -stall_current - back_emf_current, stall_current - back_emf_current), np.float64)
