"""Variables that effects act in; residuals are drawn over them, and regions of a gap are given in them."""

from typing import Literal, NamedTuple, get_args

Variable = Literal[
    "angle",
    "velocity",
    "acceleration",
    "direction",
    "travel",
    "q_axis_current",
    "current_rate",
    "power",
    "torque",
    "torque_rate",
    "winding_temperature",
    "housing_temperature",
    "time",
]


class VariableLabel(NamedTuple):
    """Label, units and quantity by which a variable is shown."""

    label: str
    units: str
    quantity: str | None  # quantity that names a region of a gap; None if regions are not given in this variable


VARIABLES: dict[str, VariableLabel] = {
    "angle": VariableLabel("angle", "rad", "angle"),
    "velocity": VariableLabel("velocity", "rad/s", "velocity"),
    "acceleration": VariableLabel("acceleration", "rad/s^2", None),
    "direction": VariableLabel("direction", "1", "direction"),
    "travel": VariableLabel("angle since the last reversal", "rad", "time_since_reversal"),
    "q_axis_current": VariableLabel("q-axis current", "A", "q_axis_current"),
    "current_rate": VariableLabel("rate of the commanded current", "A/s", None),
    "power": VariableLabel("electrical power", "W", None),
    "torque": VariableLabel("torque on the shaft", "N*m", "torque"),
    "torque_rate": VariableLabel("rate of the torque on the shaft", "N*m/s", None),
    "winding_temperature": VariableLabel("winding temperature", "degC", "winding_temperature"),
    "housing_temperature": VariableLabel("housing temperature", "degC", "housing_temperature"),
    "time": VariableLabel("time since the run's start", "s", "time"),
}
assert set(VARIABLES) == set(get_args(Variable)), "every variable is shown"
