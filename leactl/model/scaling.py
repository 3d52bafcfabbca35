"""Scale a known motor to another air-gap radius, as the paper predicts the torque constant of the LEA.

Rotor and stator keep their radial thickness, their length and their materials; the numbers of slots, poles and turns
per millimetre of circumference stay the same, all turns of a phase in series (paper, section "Frameless motor", after
Seok, Wang, Otten and Kim, 2012, and Urs, Adu, Rouse and Moore, 2022). Force is then proportional to the circumference,
and torque to its square.
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
SMALLEST_RADIUS, LARGEST_RADIUS = 1e-3, 10.0  # m; a radius that a person gave in m instead of mm is smaller
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
class ScaledFigure:
    """One quantity of the known and of the scaled motor; both values are None if the known motor lacks it."""

    name: str
    power: float  # exponent of the radius
    known: float | None
    scaled: float | None

    @property
    def units(self) -> str:
        """Unit of both figures."""
        return UNITS[self.name]


def scaled_figures(motor: MotorSheet, radius: float, known_radius: float | None = None) -> list[ScaledFigure]:
    """Return the figures of a known motor, scaled to another air-gap radius [m].

    Parameters
    ----------
    known_radius : air-gap radius of the known motor [m]; by default the one in its file.

    Raises
    ------
    InputError : a radius below a millimetre or above 10 m, or no radius of the known motor.
    """
    reference_radius = known_radius if known_radius is not None else motor.air_gap_radius
    if reference_radius is None:
        raise InputError(f"motor '{motor.name}' has no air_gap_radius; give it with --known-radius, in mm")
    for name, value in (("air-gap radius", radius), (f"air-gap radius of {motor.name}", reference_radius)):
        if not SMALLEST_RADIUS <= value <= LARGEST_RADIUS:
            expected = f"{1e3 * SMALLEST_RADIUS:g} to {1e3 * LARGEST_RADIUS:g} mm"
            raise InputError(f"{name} {1e3 * value:g} mm: a length of {expected} was expected")
    mass = motor.body.mass
    values = {name: getattr(motor, name) for name in RADIUS_EXPONENTS if name != "mass"} | {"mass": mass}
    continuous_torque = _product(motor.continuous_current, motor.torque_constant)
    derived: dict[str, tuple[float, float | None]] = {
        "motor_constant": (1.5, motor_constant(motor)),
        "torque_per_line_ampere": (2.0, electrical(motor).per_line_amplitude()),
        "continuous_torque": (2.0, continuous_torque),
        "torque_density": (1.0, _product(continuous_torque, None if mass is None else 1.0 / mass)),
    }
    figures = {name: (power, values[name]) for name, power in RADIUS_EXPONENTS.items()} | derived
    ratio = radius / reference_radius
    return [
        ScaledFigure(name, power, value, None if value is None else value * ratio**power)
        for name, (power, value) in figures.items()
    ]


def _product(first: float | None, second: float | None) -> float | None:
    """Return the product; None if a factor is not known."""
    return None if first is None or second is None else first * second
