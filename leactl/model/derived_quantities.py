"""Quantities computed from a motor sheet, to compare actuators; None if the sheet lacks what a quantity needs."""

import math
from dataclasses import dataclass

from leactl.model.motor_schema import MotorSheet
from leactl.model.winding import Electrical, resistance_ratio, voltage_ceiling


def electrical(motor: MotorSheet) -> Electrical:
    """Return the electrical parameters of the motor in the frame of its winding, wye or delta."""
    return Electrical(motor.winding, motor.phase_resistance, motor.phase_inductance, motor.torque_constant)


def motor_constant(motor: MotorSheet) -> float | None:
    """Return the torque per square root of Joule heat, Kt / sqrt(R) [N*m/sqrt(W)]."""
    if motor.torque_constant is None or motor.phase_resistance is None:
        return None
    return motor.torque_constant / math.sqrt(motor.phase_resistance)


def network_current(motor: MotorSheet, ambient: float) -> float | None:
    """Return the current [A] that takes the winding to its limit at steady state by the two-node network.

    `ambient` is in degC. All phases are heated equally, and friction adds no heat, as in the paper.
    """
    limit, thermal = motor.limits.winding_temperature, motor.thermal
    thermal_resistance = thermal.to_ambient if thermal is not None else None
    hot_resistance = resistance_at(motor, limit) if limit is not None else None
    if limit is None or thermal_resistance is None or hot_resistance is None:
        return None
    return math.sqrt(max(limit - ambient, 0.0) / (thermal_resistance * hot_resistance))


def resistance_at(motor: MotorSheet, temperature: float) -> float | None:
    """Return the phase resistance [ohm] at a winding temperature in degC."""
    resistance, coefficient = motor.phase_resistance, motor.resistance_coefficient
    reference = motor.reference_temperature
    if resistance is None or coefficient is None or reference is None:
        return None
    return resistance * resistance_ratio(temperature, coefficient, reference)


@dataclass(frozen=True)
class ContinuousTorques:
    """Continuous torque of an actuator, from the current that its source states and from its thermal network."""

    stated: float | None  # N*m
    network: float | None  # N*m
    stated_density: float | None  # N*m/kg of the whole actuator
    network_density: float | None  # N*m/kg


def continuous_torques(motor: MotorSheet, ambient: float) -> ContinuousTorques:
    """Return the continuous torques and their densities; ambient in degC."""
    constant, mass = motor.torque_constant, motor.body.mass
    stated, network = (
        None if current is None or constant is None else constant * current
        for current in (motor.continuous_current, network_current(motor, ambient))
    )
    stated_density, network_density = (
        None if torque is None or mass is None else torque / mass for torque in (stated, network)
    )
    return ContinuousTorques(stated, network, stated_density, network_density)


def fields_missing_for_friction(motor: MotorSheet) -> list[str]:
    """Return the fields that `no_load_speed` needs to include friction and that the motor file lacks."""
    return motor.missing("torque_constant", "phase_resistance", "viscous_damping", "coulomb_friction")


def no_load_speed(motor: MotorSheet, bus_voltage: float) -> float | None:
    """Return the speed at which back-EMF and the resistive drop of the friction current use up the bus voltage [rad/s].

    The root of R i + Kb w = V at i = (f + b w) / Kt, cold; V / Kb where `fields_missing_for_friction` names any.
    """
    if motor.back_emf_constant is None:
        return None
    voltage = voltage_ceiling(bus_voltage, motor.winding)
    constant, resistance = motor.torque_constant, motor.phase_resistance
    damping, friction = motor.viscous_damping, motor.coulomb_friction
    if constant is None or resistance is None or damping is None or friction is None:
        return voltage / motor.back_emf_constant
    remaining_voltage = voltage - resistance * friction / constant
    return max(remaining_voltage, 0.0) / (motor.back_emf_constant + resistance * damping / constant)
