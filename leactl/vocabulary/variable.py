"""Variables that effects act in: what a residual is drawn over, and the quantity that a region of it is given in."""

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


class Shown(NamedTuple):
    """How a variable is shown."""

    label: str
    units: str
    quantity: str | None  # by which a region of a gap is given; None where no name of a region says it


VARIABLES: dict[str, Shown] = {
    "angle": Shown("angle", "rad", "angle"),
    "velocity": Shown("velocity", "rad/s", "velocity"),
    "acceleration": Shown("acceleration", "rad/s^2", None),
    "direction": Shown("direction", "1", "direction"),
    "travel": Shown("angle since the last reversal", "rad", "time_since_reversal"),
    "q_axis_current": Shown("q-axis current", "A", "q_axis_current"),
    "current_rate": Shown("rate of the commanded current", "A/s", None),
    "power": Shown("electrical power", "W", None),
    "torque": Shown("torque on the shaft", "N*m", "torque"),
    "torque_rate": Shown("rate of the torque on the shaft", "N*m/s", None),
    "winding_temperature": Shown("winding temperature", "degC", "winding_temperature"),
    "housing_temperature": Shown("housing temperature", "degC", "housing_temperature"),
    "time": Shown("time since the run's start", "s", "time"),
}
assert set(VARIABLES) == set(get_args(Variable)), "every variable is shown"
