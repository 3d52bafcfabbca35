"""A motor of another air-gap radius, from one that is known: how the torque constant of the LEA was foreseen.

Rotor and stator keep their radial thickness, their length and their materials; slots, poles and turns are as many a
millimetre of circumference as before, all of a phase in series (paper, section "Frameless motor", after Seok, Wang,
Otten and Kim, 2012, and Urs, Adu, Rouse and Moore, 2022). Force then grows with the circumference and torque with its
lever too.
"""

from dataclasses import dataclass

from leactl.errors import InputError
from leactl.model.derived_quantities import electrical, motor_constant
from leactl.model.motor_schema import MotorSheet

RADIUS_EXPONENTS = {
    "torque_constant": 2.0,
    "phase_resistance": 1.0,
    "phase_inductance": 1.0,
    "rotor_inertia": 3.0,
    "pole_pairs": 1.0,
    "mass": 1.0,
}
"""Exponent of the radius for each figure; at equal current, Joule heat and cooling area both grow with the radius."""
SMALLEST, LARGEST = 1e-3, 10.0  # m; a radius told in metres lies below
UNITS = {
    "torque_constant": "N*m/A",
    "phase_resistance": "ohm",
    "phase_inductance": "H",
    "rotor_inertia": "kg*m^2",
    "pole_pairs": "1",
    "mass": "kg",
    "motor_constant": "N*m/sqrt(W)",
    "torque_per_line_ampere": "N*m/A",
    "continuous_torque": "N*m",
    "torque_density": "N*m/kg",
}


@dataclass(frozen=True)
class Scaled:
    """One figure before and after; None where the known motor's is not known."""

    name: str
    power: float
    known: float | None
    scaled: float | None

    @property
    def units(self) -> str:
        """Unit of both."""
        return UNITS[self.name]


def scaled(motor: MotorSheet, radius: float, known_radius: float | None = None) -> list[Scaled]:
    """Figures of a motor of an air-gap radius [m] after one that is known.

    Parameters
    ----------
    known_radius : of the known motor [m], where its file has none or another is meant.

    Raises
    ------
    InputError : a radius below a millimetre or above 10 m, or none of the known motor.
    """
    before = known_radius if known_radius is not None else motor.air_gap_radius
    if before is None:
        raise InputError(f"motor '{motor.name}' has no air_gap_radius; give it with --known-radius, in mm")
    for what, value in (("air-gap radius", radius), (f"air-gap radius of {motor.name}", before)):
        if not SMALLEST <= value <= LARGEST:
            expected = f"{1e3 * SMALLEST:g} to {1e3 * LARGEST:g} mm"
            raise InputError(f"{what} {1e3 * value:g} mm: a length of {expected} was expected")
    values = {name: getattr(motor, name) for name in RADIUS_EXPONENTS if name != "mass"} | {"mass": motor.body.mass}
    held = _product(motor.continuous_current, motor.torque_constant)
    derived: dict[str, tuple[float, float | None]] = {
        "motor_constant": (1.5, motor_constant(motor)),
        "torque_per_line_ampere": (2.0, electrical(motor).per_line_amplitude()),
        "continuous_torque": (2.0, held),
        "torque_density": (1.0, _product(held, None if motor.body.mass is None else 1.0 / motor.body.mass)),
    }
    every = {name: (power, values[name]) for name, power in RADIUS_EXPONENTS.items()} | derived
    ratio = radius / before
    return [
        Scaled(name, power, value, None if value is None else value * ratio**power)
        for name, (power, value) in every.items()
    ]


def _product(first: float | None, second: float | None) -> float | None:
    return None if first is None or second is None else first * second
