"""Motor files: the parameters of one actuator in SI, checked when read, with the quantities that follow from them."""

import math
from importlib import resources
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import Field

from leactl import yamlfile
from leactl.errors import InputError
from leactl.model.sheet import MotorLimits, MotorSheet, NotNegative, Positive, Thermal

Sheet = TypeVar("Sheet", bound=MotorSheet)


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
    """Refuse a rotor that is not inside of its body; a model's inertia may be that of all that turns with it."""
    mass, diameter = motor.body.mass, motor.body.outer_diameter
    if motor.rotor_inertia is not None and mass is not None and diameter is not None:
        most = mass * (0.5 * diameter) ** 2
        if motor.rotor_inertia > most:
            told = f"{motor.rotor_inertia:g} is more than all of the body's mass has at its rim, {most:.3g} kg*m^2"
            raise InputError(document.fault(("rotor_inertia",), f"{told}; is it in kg*m^2?"))
    return motor


def _document(name_or_path: str) -> yamlfile.Document:
    if name_or_path in motor_names():
        text = (resources.files("leactl.model") / "motors" / f"{name_or_path}.yaml").read_text(encoding="utf-8")
        return yamlfile.parse(text, f"{name_or_path}.yaml")
    if Path(name_or_path).suffix in (".yaml", ".yml"):
        return yamlfile.load(Path(name_or_path))
    raise InputError(f"motor '{name_or_path}' is not known; known: {', '.join(motor_names())}, or a path to a .yaml")
