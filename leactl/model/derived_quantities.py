"""What follows from a motor sheet: figures that compare actuators whatever their winding, None where it lacks some."""

import math
from dataclasses import dataclass

from leactl.model.motor_schema import MotorSheet
from leactl.model.winding import Electrical, voltage_ceiling


def electrical(motor: MotorSheet) -> Electrical:
    """The electrical figures in the winding's own frame."""
    return Electrical(motor.winding, motor.phase_resistance, motor.phase_inductance, motor.torque_constant)


def motor_constant(motor: MotorSheet) -> float | None:
    """Torque per square root of Joule heat, Kt / sqrt(R) [N*m/sqrt(W)]."""
    if motor.torque_constant is None or motor.phase_resistance is None:
        return None
    return motor.torque_constant / math.sqrt(motor.phase_resistance)


def network_current(motor: MotorSheet, ambient: float) -> float | None:
    """Current that takes the winding to its limit in the end by the two-node network [A]; ambient in degC.

    Heat alike in all phases and none of friction, as the paper has it.
    """
    limit, thermal = motor.limits.winding_temperature, motor.thermal
    outwards = thermal.to_ambient if thermal is not None else None
    hot = resistance_at(motor, limit) if limit is not None else None
    if limit is None or outwards is None or hot is None:
        return None
    return math.sqrt(max(limit - ambient, 0.0) / (outwards * hot))


def resistance_at(motor: MotorSheet, temperature: float) -> float | None:
    """Phase resistance at a winding temperature [ohm]."""
    cold, slope, reference = motor.phase_resistance, motor.resistance_coefficient, motor.reference_temperature
    if cold is None or slope is None or reference is None:
        return None
    return cold * (1.0 + slope * (temperature - reference))


@dataclass(frozen=True)
class Torques:
    """What an actuator holds for ever, by the current that its source states and by its own network."""

    stated: float | None  # N*m
    network: float | None  # N*m
    stated_density: float | None  # N*m/kg of the whole actuator
    network_density: float | None  # N*m/kg


def continuous_torques(motor: MotorSheet, ambient: float) -> Torques:
    """Continuous torque and its density; ambient in degC."""
    constant, mass = motor.torque_constant, motor.body.mass
    held = [
        None if current is None or constant is None else constant * current
        for current in (motor.continuous_current, network_current(motor, ambient))
    ]
    dense = [None if torque is None or mass is None else torque / mass for torque in held]
    return Torques(held[0], held[1], dense[0], dense[1])


def fields_missing_for_friction(motor: MotorSheet) -> list[str]:
    """The fields that a motor file lacks for `no_load_speed` to include friction."""
    return motor.missing("torque_constant", "phase_resistance", "viscous_damping", "coulomb_friction")


def no_load_speed(motor: MotorSheet, bus_voltage: float) -> float | None:
    """Speed at which the back-EMF, and the current that friction takes, leave nothing of the bus [rad/s].

    The root of R i + Kb w = V at i = (f + b w) / Kt, cold; V / Kb where `fields_missing_for_friction` names any.
    """
    if motor.back_emf_constant is None:
        return None
    voltage = voltage_ceiling(bus_voltage, motor.winding)
    constant, resistance = motor.torque_constant, motor.phase_resistance
    damping, friction = motor.viscous_damping, motor.coulomb_friction
    if constant is None or resistance is None or damping is None or friction is None:
        return voltage / motor.back_emf_constant
    left = voltage - resistance * friction / constant
    return max(left, 0.0) / (motor.back_emf_constant + resistance * damping / constant)
