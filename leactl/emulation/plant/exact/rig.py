"""The plant of the emulated bench: two actuators on a torque-sensor shaft, stepped exactly between events.

To advance to a time, the rig steps exactly within a regime (see regime.py), finds the time at which a margin of the
regime becomes negative, changes the regime there and continues. The same calls give the same result.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from leactl.emulation.plant.effects.contract import RIG_HOOKS, PlantEffect, own_hooks
from leactl.emulation.plant.exact.propagator import TICK, TOP_LEVEL, Propagator
from leactl.emulation.plant.exact.regime import (
    ANGLE,
    CONSTANT,
    CORRECTION,
    CURRENT,
    FILTERED,
    INPUTS,
    INTEGRAL,
    PER_ACTUATOR,
    SETPOINT,
    SHAFT_TORQUE,
    SIZE,
    STATES,
    TORQUE,
    VELOCITY,
    ActuatorRegime,
    Array,
    Regime,
    RigParameters,
    Switch,
    electric,
)
from leactl.emulation.plant.exact.rig_phases import HottestPhase, RigPhases, refuse_unused_phase_settings
from leactl.emulation.plant.noise import Noise
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters
from leactl.emulation.plant.thermal import ExactThermalNetwork
from leactl.errors import InputError

MODES = ("off", "current", "velocity", "angle")
SETUPS = ("free", "locked", "coupled", "heated")
ROLES = ("test", "load")
MARGIN_TOLERANCE = 1e-9  # in the margin's unit
LEAST_ADVANCE_S = 1e-9  # rounding error of the requested times; a shorter time changes nothing
RESTART_LEVEL = 3  # level of the first step after a change of regime: 0.25 ms
MOST_IDLE_CHANGES = 8  # of the regime without time passing, as of regimes that alternate at one point
LEAST_POWERED_V = 10.0  # DC link voltage; below it the drives are off
LEAST_VOLTAGE_CHANGE_V = 0.01  # of the DC link; a smaller change keeps the matrices
MOST_RESISTANCE_CHANGE = 0.002  # relative; after a larger change the matrices are computed again


class Actuator:
    """One actuator of the rig; the rig holds its state."""

    def __init__(self, rig: "Rig", index: int, parameters: ActuatorParameters, ambient: float) -> None:
        self.parameters = parameters
        self.thermal = ExactThermalNetwork(parameters.thermal, ambient)
        self.mode = "off"
        self.setpoint = 0.0
        self._rig, self._index, self._first_state = rig, index, index * PER_ACTUATOR

    def command(self, mode: str, value: float = 0.0) -> None:
        """Hold a q-axis current [A], a velocity [rad/s] or an angle [rad], or let no current flow ("off")."""
        if mode not in MODES:
            raise InputError(f"mode {mode!r} is unknown; known are {', '.join(MODES)}")
        if not abs(value) < 1e9:
            raise InputError(f"setpoint {value} of mode {mode} is not a number a drive can hold")
        if mode != self.mode or value != self.setpoint:
            self._rig.take_command(self._index, mode, float(value))

    @property
    def current(self) -> float:
        """Q-axis current as the drive's sensor reads it [A]."""
        return self._rig.sensed_current(self._index)

    @property
    def current_true(self) -> float:
        """True q-axis current [A]."""
        return self._rig.state(self._first_state + CURRENT)

    @property
    def voltage(self) -> float:
        """Q-axis voltage at the terminals [V]; the back-EMF while off."""
        return self._rig.voltage(self._index)

    @property
    def velocity_true(self) -> float:
        """True velocity of the rotor [rad/s]."""
        return self._rig.state(self._first_state + VELOCITY)

    @property
    def velocity(self) -> float:
        """Filtered velocity that the drive reports [rad/s]."""
        return self._rig.state(self._first_state + FILTERED)

    @property
    def angle(self) -> float:
        """Angle of the rotor [rad]."""
        return self._rig.state(self._first_state + ANGLE)

    @property
    def winding_temperature(self) -> float:
        """Temperature of the winding [degC]."""
        return self.thermal.winding

    @property
    def housing_temperature(self) -> float:
        """Temperature of the housing [degC]."""
        return self.thermal.housing

    @property
    def resistance(self) -> float:
        """Phase resistance at the winding's temperature [ohm]."""
        return self.parameters.resistance(self.thermal.winding)


class Rig:
    """Two actuators, `actuators["test"]` and `actuators["load"]`, in one setup."""

    def __init__(
        self,
        setup: str,
        test: ActuatorParameters | None = None,
        load: ActuatorParameters | None = None,
        bench: BenchParameters | None = None,
        seed: int = 0,
        effects: Sequence[PlantEffect] = (),
    ) -> None:
        if setup not in SETUPS:
            raise InputError(f"setup {setup!r} is unknown; known are {', '.join(SETUPS)}")
        self.setup, self.time, self.bench = setup, 0.0, bench or BenchParameters()
        self._bus_voltage = self.bench.bus_voltage
        self.effects = tuple(effects)
        stepped_only = [effect for effect in self.effects if not set(own_hooks(effect)) <= set(RIG_HOOKS)]
        if stepped_only:
            names = ", ".join(effect.effect_name() for effect in stepped_only)
            raise InputError(f"effect {names}: only the stepped plant has a form for it, the emulated bench has none")
        self.noise = Noise(seed)
        self.heater_current = 0.0  # A, DC through two leads of the test actuator, heated setup only
        self.hung_torque = 0.0  # N*m, of weights on an arm of the torque sensor
        test_parameters, load_parameters = test or ActuatorParameters(), load or ActuatorParameters()
        actuators = [
            Actuator(self, k, p, self.bench.ambient_temperature)
            for k, p in enumerate((test_parameters, load_parameters))
        ]
        self._pair = actuators
        self.actuators = dict(zip(ROLES, actuators, strict=True))
        refuse_unused_phase_settings(self.bench, test_parameters, load_parameters)
        current_offsets = tuple(self._sense_current(k, 0.0) for k in (0, 1))
        current_gains = tuple(self._sense_current(k, 1.0) - current_offsets[k] for k in (0, 1))
        self._plant = RigParameters(
            (test_parameters, load_parameters),
            self.bench,
            (current_gains[0], current_gains[1]),
            (current_offsets[0], current_offsets[1]),
        )
        self._torque_effects = [
            [effect for effect in self.effects if effect.adds_torque and effect.role == role] for role in ROLES
        ]
        self._has_torque_effects = any(self._torque_effects)
        self._top_level = RESTART_LEVEL if self._has_torque_effects else TOP_LEVEL
        self._point = np.zeros(SIZE)
        self._point[CONSTANT] = 1.0
        self._idle_changes = 0  # of the regime, since time last passed
        self._squared_current_integrals = [0.0, 0.0]  # A^2*s since the last thermal step
        self._friction_heat = [0.0, 0.0]  # J since the last thermal step
        self._phases = RigPhases(actuators, self.bench.ambient_temperature) if self.bench.phase_resolved else None
        self._propagators: dict[Regime, Propagator] = {}
        self._resistances = [a.resistance for a in actuators]
        self._regime = Regime(setup, (ActuatorRegime(), ActuatorRegime()), (test_parameters.phase_resistance,) * 2)
        self._enter(self._regime)

    # ---------------------------------------------------------------- readings

    @property
    def shaft_torque(self) -> float:
        """Torque of the test actuator onto the shaft as the sensor reads it [N*m]; positive when it drives."""
        torque = float(self._point[SHAFT_TORQUE]) + self.hung_torque
        for effect in self.effects:
            torque = effect.sense_torque(torque)
        return torque

    @property
    def bus_voltage(self) -> float:
        """DC link voltage of both drives [V]."""
        return self._bus_voltage

    @property
    def bus_power(self) -> float:
        """Power that both drives take from their supply [W], without the drives' own losses."""
        return sum(self.voltage(k) * self.state(k * PER_ACTUATOR + CURRENT) for k in (0, 1))

    @property
    def lead_resistance(self) -> float:
        """Resistance between two leads of the test actuator [ohm]: two phases in series."""
        return 2.0 * self._pair[0].resistance if self._phases is None else self._phases.lead_resistance

    @property
    def line_current(self) -> float:
        """Direct current through two leads of the test actuator [A]; zero unless heated."""
        return self.heater_current if self.setup == "heated" else 0.0

    @property
    def line_voltage(self) -> float:
        """Voltage between the two heated leads [V]."""
        return self.lead_resistance * self.line_current

    def hottest_phase(self, role: str) -> HottestPhase:
        """Return the present and the highest temperature of an actuator's hottest phase [degC].

        Raises
        ------
        InputError : the bench does not resolve the phases.
        """
        if self._phases is None:
            raise InputError("the bench's phases are not resolved; set emulated.bench.phase_resolved: true")
        self._phases.apply_gathered_heat(self._friction_heat)
        return self._phases.hottest(ROLES.index(role))

    def part_of_winding(self, role: str, part: str) -> float:
        """Return the temperature of the `active` phases, which two leads feed, or of the `inactive` one [degC].

        If the phases are not resolved, both are the temperature of the whole winding.
        """
        if self._phases is None:
            return self.actuators[role].winding_temperature
        self._phases.apply_gathered_heat(self._friction_heat)
        return self._phases.part_temperature(ROLES.index(role), part)

    def state(self, index: int) -> float:
        """Return the state or input at an index of regime.py."""
        return float(self._point[index])

    def sensed_current(self, k: int) -> float:
        """Return the q-axis current as the sensor of one drive reads it [A]."""
        current = float(self._point[k * PER_ACTUATOR + CURRENT])
        return self._plant.current_gains[k] * current + self._plant.current_offsets[k]

    def voltage(self, k: int) -> float:
        """Return the q-axis voltage at the terminals of one actuator [V]."""
        self._set_voltage_correction()
        ceiling = self._plant.voltage_ceiling(k)
        actuator_regime = self._regime.actuators[k]
        if actuator_regime.voltage:
            return actuator_regime.voltage * ceiling
        voltage = float(self._propagator.voltage_rows[k].dot(self._point))
        return voltage if actuator_regime.mode == "off" else min(max(voltage, -ceiling), ceiling)

    def _sense_current(self, k: int, current: float) -> float:
        """Return what one drive's sensor reads at a current [A], with the effects of the sensor."""
        for effect in self.effects:
            if effect.role == ROLES[k]:
                current = effect.sense_current(current)
        return current

    # ---------------------------------------------------------------- commands

    def supply(self, voltage: float) -> None:
        """Set the DC link voltage [V] from now on; below `LEAST_POWERED_V` the drives are off."""
        self._bus_voltage = voltage
        if voltage < LEAST_POWERED_V:
            for actuator in self._pair:
                actuator.command("off")
            return
        if abs(voltage - self.bench.bus_voltage) < LEAST_VOLTAGE_CHANGE_V:
            return
        self.bench = replace(self.bench, bus_voltage=voltage)
        self._plant = self._plant._replace(bench=self.bench)
        self._propagators.clear()  # their matrices depend on the voltage ceiling
        for k in (0, 1):
            self._find_reached_limits(k)

    def take_command(self, k: int, mode: str, value: float) -> None:
        """Set mode and setpoint of one drive, from now on."""
        if self.setup == "heated" and mode != "off":
            raise InputError("the heated setup has no drive: set heater_current, or choose another setup")
        if self._bus_voltage < LEAST_POWERED_V:
            mode = "off"
        actuator, x = self._pair[k], k * PER_ACTUATOR
        previous_mode, actuator.mode, actuator.setpoint = actuator.mode, mode, value
        if mode == "off":
            self._point[x + CURRENT] = self._point[x + INTEGRAL] = 0.0
        elif (previous_mode in ("off", "current")) != (mode == "current"):
            self._point[x + INTEGRAL] = self._point[x + CURRENT]
        peak = self.bench.peak_current
        self._point[STATES + k * INPUTS + SETPOINT] = min(max(value, -peak), peak) if mode == "current" else value
        self._find_reached_limits(k)

    def _find_reached_limits(self, k: int) -> None:
        """Find which limits of one drive are reached after a jump of its command."""
        slip = self._regime.actuators[k].slip
        actuator_regime = ActuatorRegime(self._pair[k].mode, slip=slip)
        regime = self._regime_with(k, actuator_regime)
        if actuator_regime.mode == "angle":
            row = electric(self._plant, regime, k).speed_setpoint
            actuator_regime = actuator_regime._replace(speed=self._reached_side(row, self.bench.speed_limit))
            regime = self._regime_with(k, actuator_regime)
        if actuator_regime.mode != "off":
            row = electric(self._plant, regime, k).current_setpoint
            actuator_regime = actuator_regime._replace(current=self._reached_side(row, self.bench.peak_current))
            regime = self._regime_with(k, actuator_regime)
            row = electric(self._plant, regime, k).voltage
            actuator_regime = actuator_regime._replace(voltage=self._reached_side(row, self._plant.voltage_ceiling(k)))
            regime = self._regime_with(k, actuator_regime)
        self._enter(regime)

    def _reached_side(self, row: Array, limit: float) -> int:
        """Return the sign of the row's present value if that exceeds the limit, else 0."""
        value = float(row @ self._point)
        return int(math.copysign(1, value)) if abs(value) > limit else 0

    def _regime_with(self, k: int, actuator_regime: ActuatorRegime) -> Regime:
        """Return the present regime with that of one actuator replaced."""
        test_regime, load_regime = self._regime.actuators
        return self._regime._replace(
            actuators=(actuator_regime, load_regime) if k == 0 else (test_regime, actuator_regime)
        )

    def _enter(self, regime: Regime) -> None:
        """Make a regime the present one; the next step is short, as the next event may be near."""
        propagator = self._propagators.get(regime)
        if propagator is None:
            if len(self._propagators) > 200:  # bounds the memory: warming windings lead to ever new resistances
                self._propagators.clear()
            propagator = self._propagators[regime] = Propagator(self._plant, regime)
        self._regime, self._propagator, self._level = regime, propagator, RESTART_LEVEL

    # ---------------------------------------------------------------- time

    def advance(self, to_time: float) -> None:
        """Advance to a time [s]; a time in the past changes nothing."""
        duration = to_time - self.time
        if duration <= 0.0:
            return
        self.time = to_time
        if self.setup == "heated" and self._phases is not None:
            self._phases.heat_leads(duration, self.heater_current)
            return
        if self.setup == "heated":
            heat = 2.0 * self._pair[0].resistance * self.heater_current**2
            self._pair[0].thermal.step(round(duration, 9), heat)
            self._pair[1].thermal.step(round(duration, 9), 0.0)
            return
        self._refresh_resistances()
        self._step_through(duration)
        if self._phases is not None:
            return
        for k, actuator in enumerate(self._pair):
            heat = self._resistances[k] * self._squared_current_integrals[k] / duration
            actuator.thermal.step(round(duration, 9), heat, self._friction_heat[k] / duration)
        self._squared_current_integrals = [0.0, 0.0]
        self._friction_heat = [0.0, 0.0]

    def _refresh_resistances(self) -> None:
        """Update the resistances, and the matrices if one has changed by more than `MOST_RESISTANCE_CHANGE`."""
        is_stale = False
        for k in (0, 1):
            self._resistances[k] = resistance = self._pair[k].resistance
            matrix_resistance = self._regime.resistances[k]
            is_stale = is_stale or abs(resistance - matrix_resistance) > MOST_RESISTANCE_CHANGE * matrix_resistance
        if is_stale:
            level = self._level
            self._enter(self._regime._replace(resistances=(self._resistances[0], self._resistances[1])))
            self._level = level

    def _set_voltage_correction(self) -> None:
        """Set the voltage correction for the difference between each resistance and the rounded one of the matrices."""
        point, matrix_resistances = self._point, self._regime.resistances
        for k in (0, 1):
            resistance_excess = self._pair[k].resistance - matrix_resistances[k]
            point[STATES + k * INPUTS + CORRECTION] = resistance_excess * point[k * PER_ACTUATOR + CURRENT]

    def _set_effect_torques(self) -> None:
        """Set the torques of the effects at the angle in the middle of a step of 0.25 ms, which is 8 ticks."""
        for k, effects in enumerate(self._torque_effects):
            if effects:
                velocity = self.state(k * PER_ACTUATOR + VELOCITY)
                angle = self.state(k * PER_ACTUATOR + ANGLE) + velocity * 4 * TICK
                self._point[STATES + k * INPUTS + TORQUE] = sum(effect.torque(angle, velocity) for effect in effects)

    def _step_through(self, duration: float) -> None:
        """Advance by a duration [s] in steps of 2^level ticks; steps grow until an event shortens them."""
        remaining = duration
        while remaining > LEAST_ADVANCE_S:
            resistances = self._resistances
            point, matrix_resistances = self._point, self._regime.resistances
            # as in _set_voltage_correction: 14 and 17 are the corrections, 0 and 5 the currents
            point[14] = (resistances[0] - matrix_resistances[0]) * point[0]
            point[17] = (resistances[1] - matrix_resistances[1]) * point[5]
            if self._has_torque_effects:
                self._set_effect_torques()
            ticks = int(remaining / TICK + 1e-6)
            if ticks == 0:
                remaining -= self._step_to_event(remaining)
                continue
            level = min(self._level, ticks.bit_length() - 1)
            propagator = self._propagator
            state_and_margins = propagator.step(level).dot(point)
            margins = state_and_margins[STATES:]
            if propagator.margin_count and margins.min() < -MARGIN_TOLERANCE:
                remaining -= self._retreat(level, margins, min(remaining, TICK))
                continue
            step = TICK * (1 << level)
            self._accept(state_and_margins[:STATES], step)
            remaining -= step
            if level == self._level and level < self._top_level:
                self._level = level + 1

    def _accept(self, state: Array, step: float) -> None:
        """Make a state the present one; integrate squared currents and friction over the step [s] by trapezoids."""
        point, half_step = self._point, 0.5 * step
        self._squared_current_integrals[0] += half_step * (point.item(0) ** 2 + state.item(0) ** 2)
        self._squared_current_integrals[1] += half_step * (point.item(5) ** 2 + state.item(5) ** 2)
        if self.bench.friction_heat:
            for k, actuator in enumerate(self._pair):
                for speed in (abs(point.item(5 * k + VELOCITY)), abs(state.item(5 * k + VELOCITY))):
                    p = actuator.parameters
                    self._friction_heat[k] += half_step * (p.viscous_damping * speed + p.coulomb_friction) * speed
        if self._phases is not None:
            self._phases.gather_step(step, point, state, self._friction_heat)
        point[:STATES] = state

    def _retreat(self, level: int, margins: Array, remaining: float) -> float:
        """Advance to the last point before a margin is negative, and shorten the steps; return the elapsed time [s]."""
        propagator = self._propagator
        points_before = int(np.argmax((margins < -MARGIN_TOLERANCE).reshape(-1, propagator.margin_count).any(axis=1)))
        if level == 0:
            return self._step_to_event(remaining)
        spacing_level = 0 if level <= RESTART_LEVEL else RESTART_LEVEL
        elapsed, points_left = 0.0, points_before
        step_level = spacing_level
        while points_left:
            if points_left & 1:
                step = TICK * (1 << step_level)
                self._accept(propagator.step(step_level).dot(self._point)[:STATES], step)
                elapsed += step
            points_left >>= 1
            step_level += 1
        self._level = spacing_level if spacing_level else 0
        return elapsed

    def _step_to_event(self, duration: float) -> float:
        """Advance by at most a tick; stop and change the regime where a margin is lost; return the elapsed time [s]."""
        propagator, point = self._propagator, self._point
        advanced = propagator.after(point, duration)
        if not propagator.margin_count:
            self._accept(advanced[:STATES], duration)
            return duration
        margins_before, margins_after = propagator.margins @ point, propagator.margins @ advanced
        if margins_after.min() >= -MARGIN_TOLERANCE:
            self._accept(advanced[:STATES], duration)
            return duration
        share, lost_margin = 2.0, 0
        for index in np.flatnonzero(margins_after < -MARGIN_TOLERANCE):
            margin_before = max(float(margins_before[index]), 0.0)
            crossing_share = margin_before / (margin_before - float(margins_after[index]))
            if crossing_share < share:
                share, lost_margin = crossing_share, int(index)
        share = self._refine(lost_margin, duration, share)
        if share > 0.0:
            self._idle_changes = 0
            self._accept(propagator.after(point, share * duration)[:STATES], share * duration)
        else:
            self._idle_changes += 1
            if self._idle_changes > MOST_IDLE_CHANGES:  # regimes that alternate at one point: let one tick pass
                self._idle_changes = 0
                self._accept(advanced[:STATES], duration)
                self._settle_signs()
                return duration
        self._switch(propagator.switches[lost_margin])
        return share * duration

    def _settle_signs(self) -> None:
        """Set a velocity to zero if a forced tick has reversed it against its slip."""
        for k, actuator_regime in enumerate(self._regime.actuators):
            if actuator_regime.slip * self.state(k * PER_ACTUATOR + VELOCITY) < 0.0:
                self._point[k * PER_ACTUATOR + VELOCITY] = 0.0

    def _refine(self, margin_index: int, duration: float, share: float) -> float:
        """Return the share of a step of at most a tick at which one margin is zero, by steps of the regula falsi."""
        row, low_share = self._propagator.margins[margin_index], 0.0
        margin: Callable[[float], float] = lambda x: float(row @ self._propagator.after(self._point, x * duration))  # noqa: E731
        low_margin, high_share, high_margin = margin(0.0), 1.0, margin(1.0)
        if low_margin <= 0.0:
            return 0.0
        for _ in range(4):
            present_margin = margin(share)
            if abs(present_margin) < 0.1 * MARGIN_TOLERANCE:
                break
            if present_margin > 0.0:
                low_share, low_margin = share, present_margin
            else:
                high_share, high_margin = share, present_margin
            share = low_share + (high_share - low_share) * low_margin / (low_margin - high_margin)
        return share

    def _switch(self, switch: Switch) -> None:
        """Change the regime; a rotor at rest slips again at once if the torque on it exceeds its friction."""
        k = switch.actuator
        actuator_regime = self._regime.actuators[k]
        value = switch.value
        if switch.field == "slip" and value == 0:
            self._point[k * PER_ACTUATOR + VELOCITY] = 0.0
            net_torque = self._propagator.net_torque(k, self._point)
            if abs(net_torque) > self._plant.actuators[k].coulomb_friction + MARGIN_TOLERANCE:
                value = 1 if net_torque > 0.0 else -1
        changes: dict[str, Any] = {switch.field: value}
        self._enter(self._regime_with(k, actuator_regime._replace(**changes)))


__all__ = ["FILTERED", "LEAST_POWERED_V", "ROLES", "SETUPS", "Rig"]
