"""The box of thermal parameters of an actuator: for each parameter the range that the motor file's tolerance allows."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.model.motor import Motor

Array = npt.NDArray[np.float64]
PHASE_SHARE = 2.0 / 3.0  # of the copper heat, in the hottest phase of a rotor that stands


@dataclass(frozen=True)
class Range:
    """Lowest and highest value of one parameter."""

    low: float
    high: float

    @classmethod
    def around(cls, value: float, tolerance: float) -> "Range":
        """Return the range of a value with a relative tolerance."""
        return cls(value * (1.0 - tolerance), value * (1.0 + tolerance))

    def cells(self, count: int) -> tuple[Array, Array]:
        """Return lower and upper edges of `count` cells of equal width on a logarithmic scale, shape (count,) each."""
        edges = np.geomspace(self.low, self.high, count + 1)
        return edges[:-1], edges[1:]


@dataclass(frozen=True)
class Box:
    """Ranges of thermal network, winding resistance, friction, current reading and ambient of one actuator.

    SI units, temperatures in degC.
    """

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
    current_gain: float  # largest ratio of the true current to its reading
    ambient_rise: float  # K, largest excess of the true ambient over that of the bench file
    winding_limit: float  # degC, of the hottest phase
    temperature_rise: float  # share of the true rise above ambient by which the network's rise may be too small

    def limit(self, other_limit: float, ambient: float) -> float:
        """Return the limit of the network's hottest phase [degC] that keeps the true phase below the motor's limit.

        Parameters
        ----------
        other_limit : another limit of the true temperature [degC].
        ambient : temperature of the air as in the bench file [degC]; the true rise is largest in the coldest air.
        """
        limit = min(self.winding_limit, other_limit)
        return limit - self.temperature_rise * (limit - (ambient - self.ambient_rise))

    @classmethod
    def of(cls, motor: Motor) -> "Box":
        """Return the box of a motor file.

        Raises
        ------
        InputError : the file has no `tolerances:`; without them nothing can be promised of a winding.
        """
        tolerances = motor.tolerances
        if tolerances is None:
            raise InputError(
                f"motor '{motor.name}': no `tolerances:`; a bound of its winding's temperature has to know how far off"
                " each parameter may be"
            )
        return cls._from_tolerances(motor, tolerances.model_dump())

    @classmethod
    def exact(cls, motor: Motor) -> "Box":
        """Return a box without width, which holds the values of the motor file."""
        return cls._from_tolerances(motor, {})

    @classmethod
    def favourable(cls, motor: Motor) -> "Box":
        """Return the corner of the box at which an actuator stays coolest, as a box without width."""
        box = cls.of(motor)
        fields = {name: getattr(box, name) for name in cls.__annotations__}
        ranges = {name: value for name, value in fields.items() if isinstance(value, Range)}
        corner = {
            name: Range(corner_value, corner_value)
            for name, bounds in ranges.items()
            for corner_value in [bounds.high if name.endswith("capacitance") else bounds.low]
        }
        least_factors = {"current_gain": 2.0 - box.current_gain, "ambient_rise": -box.ambient_rise}
        return cls(**fields | corner | least_factors | {"temperature_rise": -box.temperature_rise})

    @classmethod
    def _from_tolerances(cls, motor: Motor, tolerances: dict[str, float]) -> "Box":
        """Return the box of a motor with tolerances by parameter name; a parameter without one has no width."""
        motor_fields = motor.model_dump()
        values = motor_fields | motor_fields["thermal"]
        names = [name for name, annotation in cls.__annotations__.items() if annotation is Range]
        ranges = {name: Range.around(values[name], tolerances.get(name, 0.0)) for name in names}
        return cls(
            **ranges,
            reference_temperature=motor.reference_temperature,
            current_gain=1.0 + tolerances.get("current", 0.0),
            ambient_rise=tolerances.get("ambient_K", 0.0),
            winding_limit=motor.limits.winding_temperature,
            temperature_rise=tolerances.get("temperature_rise", 0.0),
        )
