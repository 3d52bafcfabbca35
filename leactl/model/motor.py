"""Motor files: the parameters of one actuator in SI, checked when read, with the quantities that follow from them."""

import math
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from leactl import yamlfile
from leactl.errors import InputError

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
STRICT = ConfigDict(frozen=True, extra="forbid")


class Thermal(BaseModel):
    """The paper's two-node network: winding and housing against ambient."""

    model_config = STRICT
    winding_ambient_resistance: Positive  # K/W
    winding_housing_resistance: Positive  # K/W
    housing_ambient_resistance: Positive  # K/W
    winding_capacitance: Positive  # J/K
    housing_capacitance: Positive  # J/K


Tolerance = Annotated[float, Field(ge=0, le=0.5)]


class Tolerances(BaseModel):
    """How far the bench's actuator may be from this file: fractions of each value, unless a unit is in the name.

    `current` is that of the drive's current reading, ripple and d axis included; `ambient_K` that of the ambient that a
    bench file tells.
    """

    model_config = STRICT
    phase_resistance: Tolerance
    resistance_coefficient: Tolerance
    winding_ambient_resistance: Tolerance
    winding_housing_resistance: Tolerance
    housing_ambient_resistance: Tolerance
    winding_capacitance: Tolerance
    housing_capacitance: Tolerance
    viscous_damping: Tolerance
    coulomb_friction: Tolerance
    current: Tolerance
    ambient_K: Annotated[float, Field(ge=0, le=30)]  # noqa: N815 (a unit keeps its letter)


class MotorLimits(BaseModel):
    """What the maker allows."""

    model_config = STRICT
    winding_temperature: Annotated[float, Field(gt=25, le=250)]  # degC


class Motor(BaseModel):
    """One actuator: q axis, power-invariant transform; temperatures in degC."""

    model_config = STRICT
    name: str
    winding: Literal["wye", "delta"]
    pole_pairs: Annotated[int, Field(ge=1, le=500)]
    phase_resistance: Positive  # ohm, half the line-to-line resistance of a wye winding, at reference_temperature
    resistance_coefficient: Annotated[float, Field(ge=0, le=0.02)]  # 1/K
    reference_temperature: Annotated[float, Field(ge=-50, le=150)]  # degC
    phase_inductance: Positive  # H
    torque_constant: Positive  # N*m/A
    back_emf_constant: Positive  # V*s/rad
    rotor_inertia: Positive  # kg*m^2
    viscous_damping: NotNegative  # N*m*s/rad
    coulomb_friction: NotNegative  # N*m
    thermal: Thermal
    limits: MotorLimits
    tolerances: Tolerances | None = None  # a motor without them is not moved

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
    InputError : no such motor or file, or a fault in it, one line each.
    """
    if name_or_path in motor_names():
        text = (resources.files("leactl.model") / "motors" / f"{name_or_path}.yaml").read_text(encoding="utf-8")
        document = yamlfile.parse(text, f"{name_or_path}.yaml")
    elif Path(name_or_path).suffix in (".yaml", ".yml"):
        document = yamlfile.load(Path(name_or_path))
    else:
        raise InputError(
            f"motor '{name_or_path}' is not known; known: {', '.join(motor_names())}, or a path to a .yaml"
        )
    return document.validate(Motor), document
