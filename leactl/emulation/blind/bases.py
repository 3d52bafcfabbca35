"""True parameters of a case, most of which differ from their nominal values, as on any bench."""

from dataclasses import dataclass, replace

import numpy as np

from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters, ThermalParameters

Generator = np.random.Generator
NOMINAL = ActuatorParameters()
# relative standard deviations of one bench against its nominal model
SPREADS = {
    "phase_resistance": 0.02,
    "phase_inductance": 0.035,
    "torque_constant": 0.015,
    "rotor_inertia": 0.035,
    "viscous_damping": 0.06,
    "coulomb_friction": 0.05,
    "winding_ambient_resistance": 0.05,
    "winding_housing_resistance": 0.05,
    "housing_ambient_resistance": 0.04,
    "winding_capacitance": 0.04,
    "housing_capacitance": 0.04,
}
RESISTANCE_COEFFICIENT_SPREAD = 0.004  # relative standard deviation, as in SPREADS


@dataclass(frozen=True)
class Base:
    """True parameters of actuators and bench, and the resistance coefficient that the nominal model has."""

    test: ActuatorParameters
    load: ActuatorParameters
    bench: BenchParameters
    nominal_coefficient: float  # 1/K, of the winding resistance


def draw_base(draw: Generator, nominal_coefficient: float) -> Base:
    """Draw a bench; the load is an actuator like the test actuator, except for its bearings."""
    motor_values = {
        name: getattr(NOMINAL, name) * _departure_factor(draw, spread) for name, spread in list(SPREADS.items())[:6]
    }
    motor_values["back_emf_constant"] = motor_values["torque_constant"]
    thermal_values = {
        name: getattr(NOMINAL.thermal, name) * _departure_factor(draw, spread)
        for name, spread in list(SPREADS.items())[6:]
    }
    motor_values["resistance_coefficient"] = nominal_coefficient * _departure_factor(
        draw, RESISTANCE_COEFFICIENT_SPREAD
    )
    test = replace(NOMINAL, thermal=ThermalParameters(**thermal_values), **motor_values)
    load = replace(
        test,
        viscous_damping=NOMINAL.viscous_damping * _departure_factor(draw, SPREADS["viscous_damping"]),
        coulomb_friction=NOMINAL.coulomb_friction * _departure_factor(draw, SPREADS["coulomb_friction"]),
    )
    nominal_stiffness = BenchParameters().shaft_stiffness
    stiffness_departure = float(draw.choice([-1, 1]) * draw.uniform(0.01, 0.14))
    bench = replace(
        BenchParameters(),
        shaft_stiffness=nominal_stiffness * (1.0 + stiffness_departure),
        shaft_damping_ratio=float(draw.uniform(0.02, 0.035)),
        ambient_temperature=float(draw.uniform(18.0, 28.0)),
    )
    return Base(test, load, bench, nominal_coefficient)


def _departure_factor(draw: Generator, spread: float) -> float:
    """Draw a factor that is never 1: a normal departure between 0.2 and 2.2 standard deviations."""
    while True:
        departure = float(draw.standard_normal())
        if 0.2 < abs(departure) < 2.2:
            return 1.0 + spread * departure


def nominal_text(base: Base) -> str:
    """Return the text of the nominal model file, which is stored with the runs."""
    motor, bench, thermal = NOMINAL, BenchParameters(), NOMINAL.thermal
    return f"""\
name: lea-nominal
winding: {motor.winding}
pole_pairs: {motor.pole_pairs}
phase_resistance: {motor.phase_resistance}  # ohm, at reference_temperature
resistance_coefficient: {base.nominal_coefficient}  # 1/K
reference_temperature: {motor.reference_temperature}  # degC
phase_inductance: {motor.phase_inductance:.6f}  # H
torque_constant: {motor.torque_constant}  # N*m/A, q axis, power invariant
back_emf_constant: {motor.back_emf_constant}  # V*s/rad
rotor_inertia: {motor.rotor_inertia}  # kg*m^2
viscous_damping: {motor.viscous_damping}  # N*m*s/rad
coulomb_friction: {motor.coulomb_friction}  # N*m
thermal:
  winding_ambient_resistance: {thermal.winding_ambient_resistance}  # K/W
  winding_housing_resistance: {thermal.winding_housing_resistance}  # K/W
  housing_ambient_resistance: {thermal.housing_ambient_resistance}  # K/W
  winding_capacitance: {thermal.winding_capacitance}  # J/K
  housing_capacitance: {thermal.housing_capacitance}  # J/K
bench:
  bus_voltage: {bench.bus_voltage}  # V
  current_loop_bandwidth: {bench.current_loop_bandwidth}  # Hz, first order
  velocity_filter_bandwidth: {bench.velocity_filter_bandwidth}  # Hz, first order, on encoder differences
  torque_filter_bandwidth: {bench.torque_filter_bandwidth}  # Hz, first order
  shaft_stiffness: {bench.shaft_stiffness}  # N*m/rad, between test and load actuator
limits:
  winding_temperature: 130.0  # degC
"""
