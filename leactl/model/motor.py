"""Read motor files, the parameters of one actuator in SI units, and check that they are plausible."""

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
from leactl.model.winding import resistance_ratio

Sheet = TypeVar("Sheet", bound=MotorSheet)
RESISTANCE_RANGE = 1e-5, 1e3  # ohm
LONGEST_WINDING_TIME_CONSTANT = 1.0  # s, inductance over resistance; that of real actuators is 0.1 to 20 ms
ROOM_TEMPERATURE = 25.0  # degC
# largest ratio of two conventions of current: 3/2 of amplitudes and sqrt(3) of lines, 2.6 together
LARGEST_CONVENTION_RATIO = 3.0


class Motor(MotorSheet):
    """One actuator with all parameters that a run with moving drives needs."""

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
        """Return the phase resistance [ohm] at a winding temperature [degC]."""
        return self.phase_resistance * resistance_ratio(
            temperature, self.resistance_coefficient, self.reference_temperature
        )


def motor_names() -> list[str]:
    """Return the names of the motors that ship with leactl, sorted."""
    folder = resources.files("leactl.model") / "motors"
    return sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def load_motor(name_or_path: str) -> tuple[Motor, yamlfile.Document]:
    """Read a motor by its shipped name or from a file; the document keeps the text byte for byte.

    Raises
    ------
    InputError : no such motor or file, a fault in the file, or missing parameters, one line each.
    """
    document = _document(name_or_path)
    return _plausible(document.validate(Motor), document), document


def load_sheet(name_or_path: str) -> tuple[MotorSheet, yamlfile.Document]:
    """Read a motor file in which any parameter may be missing, for uses that move no drive.

    Raises
    ------
    InputError : no such motor or file, or a fault in the file, one line each.
    """
    document = _document(name_or_path)
    return _plausible(document.validate(MotorSheet), document), document


def _plausible(motor: Sheet, document: yamlfile.Document) -> Sheet:
    """Return the motor if its parameters are plausible.

    Model files are not checked so: their inertia and friction may include everything that turns with the motor.

    Raises
    ------
    InputError : parameters that no actuator has, one line each.
    """
    faults = [
        *_inertia_faults(motor, document),
        *_friction_faults(motor, document),
        *_winding_faults(motor, document),
        *_torque_constant_faults(motor, document),
    ]
    if faults:
        raise InputError(faults)
    return motor


def _inertia_faults(motor: MotorSheet, document: yamlfile.Document) -> Iterator[str]:
    """Yield a fault if the rotor's inertia exceeds that of the body's whole mass at its outer radius."""
    mass, diameter = motor.body.mass, motor.body.outer_diameter
    if motor.rotor_inertia is not None and mass is not None and diameter is not None:
        largest_inertia = mass * (0.5 * diameter) ** 2
        if motor.rotor_inertia > largest_inertia:
            yield document.fault(
                ("rotor_inertia",),
                f"{motor.rotor_inertia:g} is more than all of the body's mass has at its rim, {largest_inertia:.3g}"
                " kg*m^2; is it in kg*m^2?",
            )


def _friction_faults(motor: MotorSheet, document: yamlfile.Document) -> Iterator[str]:
    """Yield a fault if no current of the file overcomes the friction, or if damping halves the speed at any voltage."""
    continuous = continuous_torques(motor, ROOM_TEMPERATURE)
    torques = [continuous.stated, continuous.network, motor.printed.nominal_torque, motor.printed.peak_torque_20_s]
    largest_torque = max((torque for torque in torques if torque is not None), default=math.inf)
    if motor.coulomb_friction is not None and motor.coulomb_friction > largest_torque:
        yield document.fault(
            ("coulomb_friction",),
            f"{motor.coulomb_friction:g} N*m is more than the most torque that the file's currents and printed torques"
            f" give, {largest_torque:.3g} N*m; is it in N*m?",
        )
    damping, resistance = motor.viscous_damping, motor.phase_resistance
    if damping is None or resistance is None or motor.torque_constant is None or motor.back_emf_constant is None:
        return
    shorted_damping = motor.torque_constant * motor.back_emf_constant / resistance
    if damping > shorted_damping:
        yield document.fault(
            ("viscous_damping",),
            f"{damping:g} N*m*s/rad is more than the shorted winding brakes with, {shorted_damping:.3g} N*m*s/rad; is"
            " it in N*m*s/rad, and phase_resistance in ohm?",
        )


def _winding_faults(motor: MotorSheet, document: yamlfile.Document) -> Iterator[str]:
    """Yield a fault if the resistance, or the time constant of the winding, is out of range."""
    resistance, inductance = motor.phase_resistance, motor.phase_inductance
    if resistance is None:
        return
    lowest, highest = RESISTANCE_RANGE
    if not lowest <= resistance <= highest:
        yield document.fault(
            ("phase_resistance",), f"{resistance:g} ohm: from {lowest:g} to {highest:g} ohm was expected; is it in ohm?"
        )
    elif inductance is not None and inductance / resistance > LONGEST_WINDING_TIME_CONSTANT:
        yield document.fault(
            ("phase_inductance",),
            f"{inductance:g} H over {resistance:g} ohm is a time constant of {inductance / resistance:.3g} s, at most"
            f" {LONGEST_WINDING_TIME_CONSTANT:g} s was expected; is it in H?",
        )


def _torque_constant_faults(motor: MotorSheet, document: yamlfile.Document) -> Iterator[str]:
    """Yield a fault for each value that differs from the torque constant by more than any convention of current."""
    constant, current, printed = motor.torque_constant, motor.continuous_current, motor.printed
    if constant is None:
        return
    values_by_name = {"back_emf_constant": (motor.back_emf_constant, "V*s/rad")}
    if motor.phase_resistance is not None and printed.motor_constant is not None:
        values_by_name["printed.motor_constant times sqrt(phase_resistance)"] = (
            printed.motor_constant * math.sqrt(motor.phase_resistance),
            "N*m/A",
        )
    if current is not None and printed.nominal_torque is not None:
        values_by_name["printed.nominal_torque over continuous_current"] = (printed.nominal_torque / current, "N*m/A")
    for name, (value, unit) in values_by_name.items():
        if value is not None and not 1 / LARGEST_CONVENTION_RATIO <= constant / value <= LARGEST_CONVENTION_RATIO:
            yield document.fault(
                ("torque_constant",),
                f"{constant:g} N*m/A is {constant / value:.3g} times {name}, {value:.3g} {unit}; both are one"
                " figure in SI: mend the wrong one",
            )


def _document(name_or_path: str) -> yamlfile.Document:
    """Read the file of a motor by its shipped name or its path, without checking its parameters.

    Raises
    ------
    InputError : no such motor or file, or a file that is not YAML as `yamlfile` reads it.
    """
    if name_or_path in motor_names():
        text = (resources.files("leactl.model") / "motors" / f"{name_or_path}.yaml").read_text(encoding="utf-8")
        return yamlfile.parse(text, f"{name_or_path}.yaml")
    if Path(name_or_path).suffix in (".yaml", ".yml"):
        return yamlfile.load(Path(name_or_path))
    raise InputError(f"motor '{name_or_path}' is not known; known: {', '.join(motor_names())}, or a path to a .yaml")
