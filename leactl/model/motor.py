"""Motor files: the parameters of one actuator in SI, checked when read, with the quantities that follow from them."""

import math
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import Field

from leactl import yamlfile
from leactl.errors import InputError
from leactl.model.derived_quantities import continuous_torques
from leactl.model.motor_schema import MotorLimits, MotorSheet, NotNegative, Positive, Thermal

Sheet = TypeVar("Sheet", bound=MotorSheet)
RESISTANCES = 1e-5, 1e3  # ohm
SLOWEST_WINDING = 1.0  # s; of real actuators inductance over resistance is 0.1 to 20 ms
ROOM = 25.0  # degC
# by which two conventions of current are apart at the most: 3/2 of amplitudes and sqrt(3) of lines, 2.6 together
CONVENTIONS_APART = 3.0


class Motor(MotorSheet):
    """One actuator with everything that moving it asks for."""

    pole_pairs: Annotated[int, Field(strict=True, ge=1, le=500)]
    phase_resistance: Positive  # ohm
    resistance_coefficient: Annotated[float, Field(strict=True, ge=0, le=0.02)]  # 1/K
    reference_temperature: Annotated[float, Field(strict=True, ge=-50, le=150)]  # degC
    phase_inductance: Positive  # H
    torque_constant: Positive  # N*m/A
    back_emf_constant: Positive  # V*s/rad
    rotor_inertia: Positive  # kg*m^2
    viscous_damping: NotNegative  # N*m*s/rad
    coulomb_friction: NotNegative  # N*m
    thermal: Thermal
    limits: MotorLimits

    @property
    def motor_constant(self) -> float:
        """Torque per square root of Joule heat, Kt / sqrt(R) [N*m/sqrt(W)]."""
        return self.torque_constant / math.sqrt(self.phase_resistance)

    def resistance(self, temperature: float) -> float:
        """Phase resistance [ohm] at a winding temperature [degC]."""
        return self.phase_resistance * (1 + self.resistance_coefficient * (temperature - self.reference_temperature))


def motor_names() -> list[str]:
    """Names of the motors that ship with leactl."""
    folder = resources.files("leactl.model") / "motors"
    return sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def load_motor(name_or_path: str) -> tuple[Motor, yamlfile.Document]:
    """Read a motor by its shipped name or from a file; the document keeps the text byte for byte.

    Raises
    ------
    InputError : no such motor or file, a fault in it, or figures that it lacks, one line each.
    """
    document = _document(name_or_path)
    return _plausible(document.validate(Motor), document), document


def load_sheet(name_or_path: str) -> tuple[MotorSheet, yamlfile.Document]:
    """Read what a motor file knows, however little; for what moves nothing.

    Raises
    ------
    InputError : no such motor or file, or a fault in it, one line each.
    """
    document = _document(name_or_path)
    return _plausible(document.validate(MotorSheet), document), document


def _plausible(motor: Sheet, document: yamlfile.Document) -> Sheet:
    """Refuse figures that no actuator has; a model's may be those of all that turns with it."""
    faults = [
        *_rotor_outside_of_its_body(motor, document),
        *_friction_beyond_the_winding(motor, document),
        *_no_winding(motor, document),
        *_constants_apart(motor, document),
    ]
    if faults:
        raise InputError(faults)
    return motor


def _rotor_outside_of_its_body(motor: MotorSheet, document: yamlfile.Document) -> Iterator[str]:
    mass, diameter = motor.body.mass, motor.body.outer_diameter
    if motor.rotor_inertia is not None and mass is not None and diameter is not None:
        most = mass * (0.5 * diameter) ** 2
        if motor.rotor_inertia > most:
            told = f"{motor.rotor_inertia:g} is more than all of the body's mass has at its rim, {most:.3g} kg*m^2"
            yield document.fault(("rotor_inertia",), f"{told}; is it in kg*m^2?")


def _friction_beyond_the_winding(motor: MotorSheet, document: yamlfile.Document) -> Iterator[str]:
    """Friction that no current of the file overcomes, or that takes more than half of the speed at any voltage."""
    held = continuous_torques(motor, ROOM)
    told = [held.stated, held.network, motor.printed.nominal_torque, motor.printed.peak_torque_20_s]
    most = max((torque for torque in told if torque is not None), default=math.inf)
    if motor.coulomb_friction is not None and motor.coulomb_friction > most:
        yield document.fault(
            ("coulomb_friction",),
            f"{motor.coulomb_friction:g} N*m is more than the most torque that the file's currents and printed torques"
            f" give, {most:.3g} N*m; is it in N*m?",
        )
    damping, resistance = motor.viscous_damping, motor.phase_resistance
    if damping is None or resistance is None or motor.torque_constant is None or motor.back_emf_constant is None:
        return
    shorted = motor.torque_constant * motor.back_emf_constant / resistance
    if damping > shorted:
        yield document.fault(
            ("viscous_damping",),
            f"{damping:g} N*m*s/rad is more than the shorted winding brakes with, {shorted:.3g} N*m*s/rad; is it in"
            " N*m*s/rad, and phase_resistance in ohm?",
        )


def _no_winding(motor: MotorSheet, document: yamlfile.Document) -> Iterator[str]:
    resistance, inductance = motor.phase_resistance, motor.phase_inductance
    if resistance is None:
        return
    least, most = RESISTANCES
    if not least <= resistance <= most:
        yield document.fault(
            ("phase_resistance",), f"{resistance:g} ohm: from {least:g} to {most:g} ohm was expected; is it in ohm?"
        )
    elif inductance is not None and inductance / resistance > SLOWEST_WINDING:
        yield document.fault(
            ("phase_inductance",),
            f"{inductance:g} H over {resistance:g} ohm is a time constant of {inductance / resistance:.3g} s, at most"
            f" {SLOWEST_WINDING:g} s was expected; is it in H?",
        )


def _constants_apart(motor: MotorSheet, document: yamlfile.Document) -> Iterator[str]:
    """A torque constant that the file's other figures contradict by more than any convention."""
    constant, current, printed = motor.torque_constant, motor.continuous_current, motor.printed
    if constant is None:
        return
    others = {"back_emf_constant": (motor.back_emf_constant, "V*s/rad")}
    if motor.phase_resistance is not None and printed.motor_constant is not None:
        others["printed.motor_constant times sqrt(phase_resistance)"] = (
            printed.motor_constant * math.sqrt(motor.phase_resistance),
            "N*m/A",
        )
    if current is not None and printed.nominal_torque is not None:
        others["printed.nominal_torque over continuous_current"] = (printed.nominal_torque / current, "N*m/A")
    for name, (value, unit) in others.items():
        if value is not None and not 1 / CONVENTIONS_APART <= constant / value <= CONVENTIONS_APART:
            yield document.fault(
                ("torque_constant",),
                f"{constant:g} N*m/A is {constant / value:.3g} times {name}, {value:.3g} {unit}; both are one"
                " figure in SI: mend the wrong one",
            )


def _document(name_or_path: str) -> yamlfile.Document:
    if name_or_path in motor_names():
        text = (resources.files("leactl.model") / "motors" / f"{name_or_path}.yaml").read_text(encoding="utf-8")
        return yamlfile.parse(text, f"{name_or_path}.yaml")
    if Path(name_or_path).suffix in (".yaml", ".yml"):
        return yamlfile.load(Path(name_or_path))
    raise InputError(f"motor '{name_or_path}' is not known; known: {', '.join(motor_names())}, or a path to a .yaml")
