"""The variables that effects act in, from the signals of a run, and piecewise linear functions of a variable."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from leactl.effects.contract import Signals
from leactl.gap.binned_means import last_reversal
from leactl.gap.signals.smoothing import slope
from leactl.vocabulary.variable import Variable

Array = npt.NDArray[np.float64]


def _rate(values: Array | None, interval: float) -> Array | None:
    """Return the derivative [1/s] of a signal, or None without the signal."""
    return None if values is None else slope(values, interval)


def _travel(s: Signals) -> Array | None:
    """Return the distance [rad] from the last reversal, or None without an angle and a velocity."""
    if s.angle is None or s.velocity is None:
        return None
    return np.asarray(np.abs(s.angle - s.angle[last_reversal(s.velocity)]), np.float64)


def _power(s: Signals) -> Array | None:
    """Return the electrical power v_q i_q [W], or None without voltage and current."""
    return None if s.voltage is None or s.current is None else s.voltage * s.current


VARIABLE_FUNCTIONS: dict[Variable, Callable[[Signals], Array | None]] = {
    "angle": lambda s: s.angle,
    "velocity": lambda s: s.velocity,
    "acceleration": lambda s: s.acceleration,
    "direction": lambda s: None if s.velocity is None else np.sign(s.velocity),
    "travel": _travel,
    "q_axis_current": lambda s: s.current if s.current is not None else s.line_current,
    "current_rate": lambda s: _rate(s.following if s.following is not None else s.current, s.interval),
    "power": _power,
    "torque": lambda s: s.torque,
    "torque_rate": lambda s: _rate(s.calm_torque, s.interval),
    "winding_temperature": lambda s: s.winding,
    "housing_temperature": lambda s: s.housing,
    "time": lambda s: s.time,
}
"""Function that returns each variable from the signals of one run, or None if the run does not show it."""
CURRENT_VARIABLES = ("q_axis_current", "current_rate")
VARIABLES_WITH_RESIDUAL = {
    "free_torque": CURRENT_VARIABLES,
    "reversal_torque": CURRENT_VARIABLES,
    "axis_torque": CURRENT_VARIABLES,
    "lock": ("angle",),
}
"""Variables that contain an equation's residual: the motion and the current together determine the residual."""


def variable_in(variable: Variable, equation: str, signals: Signals) -> Array | None:
    """Return a variable of one run by sample; None if the run lacks it or it contains the equation's residual."""
    return None if variable in VARIABLES_WITH_RESIDUAL.get(equation, ()) else VARIABLE_FUNCTIONS[variable](signals)


def state_in(equation: str, signals: Signals) -> dict[Variable, Array]:
    """Return the variables of one run, by sample, that the residual of an equation may be a function of."""
    variables = {variable: variable_in(variable, equation, signals) for variable in VARIABLE_FUNCTIONS}
    return {variable: values for variable, values in variables.items() if values is not None}


def hats(values: Array, knots: Array, period: float | None = None) -> Array:
    """Return piecewise linear functions (hats), one at each knot; constant beyond the ends, or periodic.

    values : of a variable, shape (n,).
    knots : in ascending order, shape (k,); within one period if the variable is periodic.

    Returns
    -------
    Array : (n, k); each row adds up to one.
    """
    return np.stack([np.interp(values, knots, row, period=period) for row in np.eye(len(knots))], axis=1)
