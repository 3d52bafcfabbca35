"""Regimes, within which the plant is linear: which limits are reached, which rotor sticks, and the equations that hold.

Within one regime the state obeys dx/dt = A x + B u exactly. `equations` returns these rows, and the margins: linear
functions that are positive within the regime. When a margin becomes negative, its `Switch` gives the next regime.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters

Array = NDArray[np.float64]

# State: current, velocity, angle, servo integral and filtered velocity of each actuator; then the shaft's twist and the
# filtered torque. In current mode the integral is the lagged setpoint, from which the lead is computed. Inputs:
# setpoint, torque of effects and voltage correction of each actuator; then the constant 1. Below, `k` is the index of
# an actuator (0 test, 1 load), and `x` that of its first state.
CURRENT, VELOCITY, ANGLE, INTEGRAL, FILTERED = range(5)
SETPOINT, TORQUE, CORRECTION = range(3)
PER_ACTUATOR = 5
TWIST, SHAFT_TORQUE, STATES = 10, 11, 12
INPUTS = 3
CONSTANT, SIZE = 18, 19


class ActuatorRegime(NamedTuple):
    """Regime of one actuator: signs of the limits that it has reached and of its slip; 0 is within limits, or stuck."""

    mode: str = "off"
    speed: int = 0
    current: int = 0
    voltage: int = 0
    slip: int = 0


class Regime(NamedTuple):
    """Regime of the plant; the difference of the true resistances from the ones here acts as a voltage correction."""

    setup: str
    actuators: tuple[ActuatorRegime, ActuatorRegime]
    resistances: tuple[float, float]


class Switch(NamedTuple):
    """Change of regime when a margin becomes negative: a field of an actuator's regime takes a value."""

    actuator: int
    field: str
    value: int


class Electric(NamedTuple):
    """Rows over state and inputs that give a drive's speed setpoint, current setpoint and voltage before limits."""

    speed_setpoint: Array
    current_setpoint: Array
    voltage: Array


class RigParameters(NamedTuple):
    """Parameters of both actuators and the bench, with gains and offsets of the current sensors."""

    actuators: tuple[ActuatorParameters, ActuatorParameters]
    bench: BenchParameters
    current_gains: tuple[float, float] = (1.0, 1.0)
    current_offsets: tuple[float, float] = (0.0, 0.0)

    def voltage_ceiling(self, k: int) -> float:
        """Return the highest q-axis voltage [V]: that whose amplitude between two leads is the bus voltage."""
        return self.bench.bus_voltage / self.actuators[k].lead_amplitude


def _unit(index: int, value: float = 1.0) -> Array:
    """Return a row over state and inputs that is `value` at an index and zero elsewhere."""
    row = np.zeros(SIZE)
    row[index] = value
    return row


def equations(plant: RigParameters, regime: Regime) -> tuple[Array, Array, list[Switch]]:
    """Return the generator matrix of the augmented state, the rows of the margins, and the switch of each margin."""
    generator = np.zeros((SIZE, SIZE))
    margins: list[tuple[Array, Switch]] = []
    bench = plant.bench
    coupled = regime.setup in ("coupled", "locked")
    for k in (0, 1):
        is_locked = k == 1 and regime.setup == "locked"  # the lock is at the far end of the shaft
        x, parameters, actuator_regime = k * PER_ACTUATOR, plant.actuators[k], regime.actuators[k]
        margins += _drive(plant, regime, k, generator)
        net_torque = _unit(x + CURRENT, parameters.torque_constant) + _unit(STATES + k * INPUTS + TORQUE)
        if coupled:
            sign = 1.0 if k == 0 else -1.0
            damping = shaft_damping(plant)
            net_torque[TWIST] -= sign * bench.shaft_stiffness
            net_torque[VELOCITY] -= sign * damping
            net_torque[PER_ACTUATOR + VELOCITY] += sign * damping
        friction = _unit(CONSTANT, parameters.coulomb_friction)
        if not is_locked:
            if actuator_regime.slip:
                sliding_torque = net_torque - actuator_regime.slip * friction
                sliding_torque[x + VELOCITY] -= parameters.viscous_damping
                generator[x + VELOCITY] = sliding_torque / parameters.rotor_inertia
                margins.append((_unit(x + VELOCITY, actuator_regime.slip), Switch(k, "slip", 0)))
            else:
                margins.append((friction - net_torque, Switch(k, "slip", 1)))
                margins.append((friction + net_torque, Switch(k, "slip", -1)))
            generator[x + ANGLE] = _unit(x + VELOCITY)
        rate = 2.0 * math.pi * bench.velocity_filter_bandwidth
        generator[x + FILTERED] = _unit(x + VELOCITY, rate) - _unit(x + FILTERED, rate)
    if coupled:
        generator[TWIST] = _unit(VELOCITY) - _unit(PER_ACTUATOR + VELOCITY)
    rate = 2.0 * math.pi * bench.torque_filter_bandwidth
    generator[SHAFT_TORQUE] = _unit(TWIST, rate * bench.shaft_stiffness) - _unit(SHAFT_TORQUE, rate)
    margin_rows = np.array([row for row, _ in margins]).reshape(len(margins), SIZE)
    return generator, margin_rows, [switch for _, switch in margins]


def shaft_damping(plant: RigParameters) -> float:
    """Return the damping of the shaft [N*m*s/rad] from its ratio to critical damping."""
    test_inertia, load_inertia = (actuator.rotor_inertia for actuator in plant.actuators)
    reduced_inertia = test_inertia * load_inertia / (test_inertia + load_inertia)
    return 2.0 * plant.bench.shaft_damping_ratio * math.sqrt(plant.bench.shaft_stiffness * reduced_inertia)


def net_torque_row(plant: RigParameters, regime: Regime, k: int) -> Array:
    """Return the row that gives the torque on a rotor at standstill, without friction [N*m]."""
    actuators = list(regime.actuators)
    actuators[k] = actuators[k]._replace(slip=0)
    _, margin_rows, switches = equations(plant, regime._replace(actuators=(actuators[0], actuators[1])))
    upper_margin = margin_rows[switches.index(Switch(k, "slip", 1))]
    return np.asarray(_unit(CONSTANT, plant.actuators[k].coulomb_friction) - upper_margin)


def electric(plant: RigParameters, regime: Regime, k: int) -> Electric:
    """Return the rows of one actuator's drive; each is computed from the row before it, as far as its limit allows."""
    x, parameters, actuator_regime, bench = k * PER_ACTUATOR, plant.actuators[k], regime.actuators[k], plant.bench
    setpoint = _unit(STATES + k * INPUTS + SETPOINT)
    emf = _unit(x + VELOCITY, parameters.back_emf_constant)
    if actuator_regime.mode == "off":
        return Electric(setpoint, setpoint, emf)
    speed = setpoint
    if actuator_regime.mode == "angle":
        speed = bench.position_gain * (setpoint - _unit(x + ANGLE))
    limited_speed = _unit(CONSTANT, actuator_regime.speed * bench.speed_limit) if actuator_regime.speed else speed
    current = setpoint + bench.setpoint_lead * (setpoint - _unit(x + INTEGRAL))
    if actuator_regime.mode != "current":
        velocity_gain = parameters.rotor_inertia * bench.velocity_gain / parameters.torque_constant
        current = velocity_gain * (limited_speed - _unit(x + VELOCITY)) + _unit(x + INTEGRAL)
    limited_current = (
        _unit(CONSTANT, actuator_regime.current * bench.peak_current) if actuator_regime.current else current
    )
    sensed = _unit(x + CURRENT, plant.current_gains[k]) + _unit(CONSTANT, plant.current_offsets[k])
    inductance_rate = parameters.phase_inductance * 2.0 * math.pi * bench.current_loop_bandwidth
    drop = _unit(x + CURRENT, regime.resistances[k]) + _unit(STATES + k * INPUTS + CORRECTION)
    return Electric(speed, current, drop + emf + inductance_rate * (limited_current - sensed))


def _drive(plant: RigParameters, regime: Regime, k: int, generator: Array) -> list[tuple[Array, Switch]]:
    """Write the rows of current and servo integral into the generator; return the margins of the drive's limits."""
    x, parameters, actuator_regime, bench = k * PER_ACTUATOR, plant.actuators[k], regime.actuators[k], plant.bench
    if actuator_regime.mode == "off":
        return []
    computed = electric(plant, regime, k)
    margins: list[tuple[Array, Switch]] = []
    if actuator_regime.mode == "angle":
        margins += _limit(computed.speed_setpoint, bench.speed_limit, actuator_regime.speed, k, "speed")
    if actuator_regime.mode != "current" or bench.setpoint_lead:
        margins += _limit(computed.current_setpoint, bench.peak_current, actuator_regime.current, k, "current")
    margins += _limit(computed.voltage, plant.voltage_ceiling(k), actuator_regime.voltage, k, "voltage")

    voltage = (
        _unit(CONSTANT, actuator_regime.voltage * plant.voltage_ceiling(k))
        if actuator_regime.voltage
        else computed.voltage
    )
    drop = _unit(x + CURRENT, regime.resistances[k]) + _unit(STATES + k * INPUTS + CORRECTION)
    emf = _unit(x + VELOCITY, parameters.back_emf_constant)
    generator[x + CURRENT] = (voltage - drop - emf) / parameters.phase_inductance
    if actuator_regime.mode == "current":
        if bench.setpoint_lead:
            lead_gap = _unit(STATES + k * INPUTS + SETPOINT) - _unit(x + INTEGRAL)
            generator[x + INTEGRAL] = lead_gap / bench.setpoint_lead_time
    else:
        speed = (
            _unit(CONSTANT, actuator_regime.speed * bench.speed_limit)
            if actuator_regime.speed
            else computed.speed_setpoint
        )
        current = (
            _unit(CONSTANT, actuator_regime.current * bench.peak_current)
            if actuator_regime.current
            else computed.current_setpoint
        )
        # Back-calculation keeps the right-hand side continuous across a limit, so a limit cannot chatter.
        inductance_rate = parameters.phase_inductance * 2.0 * math.pi * bench.current_loop_bandwidth
        excess_current = (computed.current_setpoint - current) + (computed.voltage - voltage) / inductance_rate
        current_per_acceleration = parameters.rotor_inertia / parameters.torque_constant
        integral_rate = current_per_acceleration * bench.velocity_integral * (speed - _unit(x + VELOCITY))
        generator[x + INTEGRAL] = integral_rate - bench.velocity_integral / bench.velocity_gain * excess_current
    return margins


def _limit(row: Array, limit: float, side: int, k: int, field: str) -> list[tuple[Array, Switch]]:
    """Return the margins of one limit: to both sides if it is not reached, else to where it is left."""
    ceiling = _unit(CONSTANT, limit)
    if side:
        return [(side * row - ceiling, Switch(k, field, 0))]
    return [(ceiling - row, Switch(k, field, 1)), (ceiling + row, Switch(k, field, -1))]
