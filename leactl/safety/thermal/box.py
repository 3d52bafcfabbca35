"""The box of thermal parameters that an actuator may have: the motor file's values and its tolerances."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.model.motor import Motor

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Range:
    """Lowest and highest value of one parameter."""

    low: float
    high: float

    @classmethod
    def around(cls, value: float, tolerance: float) -> "Range":
        """A value and its relative tolerance."""
        return cls(value * (1.0 - tolerance), value * (1.0 + tolerance))

    def cells(self, count: int) -> tuple[Array, Array]:
        """Lower and upper edges of as many cells, even on a logarithmic scale."""
        edges = np.geomspace(self.low, self.high, count + 1)
        return edges[:-1], edges[1:]


@dataclass(frozen=True)
class Box:
    """Ranges of the network, the resistance, friction, current reading and ambient of one actuator, SI, degC."""

    phase_resistance: Range
    resistance_coefficient: Range
    reference_temperature: float
    winding_ambient_resistance: Range
    winding_housing_resistance: Range
    housing_ambient_resistance: Range
    winding_capacitance: Range
    housing_capacitance: Range
    viscous_damping: Range
    coulomb_friction: Range
    current_gain: float  # true current over its reading, at the most
    ambient_rise: float  # K, of the true ambient over the one that is told, at the most

    @classmethod
    def of(cls, motor: Motor) -> "Box":
        """The box of a motor file.

        Raises
        ------
        InputError : the file has no `tolerances:`; without them nothing can be promised of a winding.
        """
        t = motor.tolerances
        if t is None:
            raise InputError(
                f"motor '{motor.name}': no `tolerances:`; a bound of its winding's temperature has to know how far off"
                " each parameter may be"
            )
        return cls._around(motor, t.model_dump())

    @classmethod
    def exact(cls, motor: Motor) -> "Box":
        """A box without width: the motor file's values as they are."""
        return cls._around(motor, {})

    @classmethod
    def _around(cls, motor: Motor, tolerances: dict[str, float]) -> "Box":
        whole = motor.model_dump()
        values = whole | whole["thermal"]
        names = [name for name, kind in cls.__annotations__.items() if kind is Range]
        ranges = {name: Range.around(values[name], tolerances.get(name, 0.0)) for name in names}
        return cls(
            **ranges,
            reference_temperature=motor.reference_temperature,
            current_gain=1.0 + tolerances.get("current", 0.0),
            ambient_rise=tolerances.get("ambient_K", 0.0),
        )
