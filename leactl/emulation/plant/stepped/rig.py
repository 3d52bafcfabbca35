"""The stepped plant with one lane and the interface of the rig, for benches with effects that the rig cannot express.

Time advances in whole milliseconds; a command takes effect at the next one; the servos use the drives' readings.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leactl.emulation.plant.effects.contract import PlantEffect
from leactl.emulation.plant.exact.rig import LEAST_POWERED_V, MODES, ROLES, SETUPS
from leactl.emulation.plant.exact.rig_phases import refuse_unused_phase_settings
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters
from leactl.emulation.plant.stepped.lanes import Lane
from leactl.emulation.plant.stepped.plant import TICK, SteppedPlant
from leactl.errors import InputError

HEATED_STEP_S = 0.2  # of the thermal network while two leads are heated


class SteppedRig:
    """Two actuators, `actuators["test"]` and `actuators["load"]`, in one setup; the same interface as `Rig`."""

    def __init__(
        self,
        setup: str,
        test: ActuatorParameters | None = None,
        load: ActuatorParameters | None = None,
        bench: BenchParameters | None = None,
        effects: Sequence[PlantEffect] = (),
    ) -> None:
        if setup not in SETUPS:
            raise InputError(f"setup {setup!r} is unknown; known are {', '.join(SETUPS)}")
        if whole_record_effects := [effect for effect in effects if effect.needs_whole_record]:
            names = ", ".join(effect.effect_name() for effect in whole_record_effects)
            raise InputError(f"effect {names}: its form needs a whole record, which a live bench has not; leave it out")
        self.setup, self.bench, self.heater_current = setup, bench or BenchParameters(), 0.0
        if self.bench.phase_resolved:
            raise InputError("phase_resolved: the stepped plant of these effects has no phases; leave it or them out")
        self.time = 0.0
        self.hung_torque = 0.0  # N*m, of weights on an arm of the torque sensor
        self._dead_bus: float | None = None  # V, a bus voltage below `LEAST_POWERED_V`; None if it is not
        lane = Lane(setup, test or ActuatorParameters(), load or ActuatorParameters(), self.bench, tuple(effects))
        refuse_unused_phase_settings(self.bench, lane.test, lane.load)
        self.plant, self._effects, self._parameters = SteppedPlant([lane]), tuple(effects), lane.test
        pair = [SteppedActuator(self, k, p) for k, p in enumerate((lane.test, lane.load))]
        self.actuators = dict(zip(ROLES, pair, strict=True))

    # ---------------------------------------------------------------- readings

    @property
    def shaft_torque(self) -> float:
        """Torque of the test actuator onto the shaft as the sensor reads it [N*m]."""
        torque, angle = self.plant.torque_read.reshape(1, 1) + self.hung_torque, self.plant.angle[:1, :1]
        for effect in self._effects:
            torque = effect.torque_record(torque, angle, np.array([[self.time]]))
        return float(torque[0, 0])

    @property
    def bus_voltage(self) -> float:
        """DC link voltage of both drives [V]."""
        return float(self.plant.bus_voltage[0]) if self._dead_bus is None else self._dead_bus

    @property
    def powered(self) -> bool:
        """Whether the DC link voltage is enough for a drive to work."""
        return self._dead_bus is None

    @property
    def bus_power(self) -> float:
        """Power that both drives take from their supply [W], without the drives' own losses."""
        return sum(actuator.voltage * actuator.current_true for actuator in self.actuators.values())

    def supply(self, voltage: float) -> None:
        """Set the DC link voltage [V] from now on; below `LEAST_POWERED_V` the drives are off."""
        self._dead_bus = voltage if voltage < LEAST_POWERED_V else None
        if self._dead_bus is not None:
            for actuator in self.actuators.values():
                actuator.command("off")
        elif voltage != self.bench.bus_voltage:
            self.bench = replace(self.bench, bus_voltage=voltage)
            self.plant.supply(voltage)

    @property
    def lead_resistance(self) -> float:
        """Resistance between two leads of the test actuator [ohm]: two phases in series."""
        return 2.0 * self.resistance

    @property
    def line_current(self) -> float:
        """Direct current through two leads of the test actuator [A]; zero unless heated."""
        return self.heater_current if self.setup == "heated" else 0.0

    @property
    def line_voltage(self) -> float:
        """Voltage between the two heated leads [V]."""
        return self.lead_resistance * self.line_current

    @property
    def resistance(self) -> float:
        """Phase resistance of the test actuator at its winding's temperature [ohm]."""
        resistance = self._parameters.resistance(float(self.plant.thermal.winding[0]))
        for effect in self._effects:
            resistance *= float(effect.resistance_share(self.plant.thermal.winding[0], self.time))
        return resistance

    def part_of_winding(self, role: str, part: str) -> float:
        """Return the winding's temperature [degC] for the `active` and the `inactive` phases: it has one node here."""
        return self.actuators[role].winding_temperature

    # ---------------------------------------------------------------- time

    def advance(self, to_time: float) -> None:
        """Advance to a time [s], the plant by whole milliseconds; a time in the past changes nothing."""
        if self.setup == "heated":
            standstill = np.zeros(1)
            while (step := min(HEATED_STEP_S, to_time - self.time)) > 1e-9:
                heat = 2.0 * self.resistance * self.heater_current**2
                self.plant.thermal.step(self.time, step, heat, standstill, standstill)
                self.time += step
            return
        while self.plant.time + TICK <= to_time + 1e-9:
            references = [actuator.reference() for actuator in self.actuators.values()]
            self.plant.advance(np.array(references).reshape(2, 1))
        self.time = max(self.time, to_time)


class SteppedActuator:
    """One actuator of the stepped rig as its drive's sensors read it; the same interface as `Actuator`."""

    def __init__(self, rig: SteppedRig, row: int, parameters: ActuatorParameters) -> None:
        self.parameters, self.mode, self.setpoint = parameters, "off", 0.0
        self._rig, self._row, self._integral = rig, row, 0.0

    def command(self, mode: str, value: float = 0.0) -> None:
        """Hold a q-axis current [A], a velocity [rad/s] or an angle [rad], or let no current flow ("off")."""
        if mode not in MODES:
            raise InputError(f"mode {mode!r} is unknown; known are {', '.join(MODES)}")
        if not abs(value) < 1e9:
            raise InputError(f"setpoint {value} of mode {mode} is not a number a drive can hold")
        if self._rig.setup == "heated" and mode != "off":
            raise InputError("the heated setup has no drive: set heater_current, or choose another setup")
        mode = mode if self._rig.powered else "off"
        if self.mode == "off":
            self._integral = 0.0
        elif (mode == "current") != (self.mode == "current"):
            self._integral = self.current
        self.mode, self.setpoint = mode, float(value)

    def reference(self) -> float:
        """Advance the servo by a millisecond; return the reference of the drive's current loop for it [A]."""
        bench, reference = self._rig.bench, self.setpoint
        if self.mode == "off":  # the sensor's reading at zero current
            return float(self._rig.plant.current_offset[self._row, 0])
        if self.mode == "current":
            reference = min(max(reference, -bench.peak_current), bench.peak_current)
            lead = (reference - self._integral) * -math.expm1(-TICK / bench.setpoint_lead_time)
            self._integral += lead
            reference += bench.setpoint_lead * lead * bench.setpoint_lead_time / TICK  # mean over the millisecond
            return min(max(reference, -bench.peak_current), bench.peak_current)
        if self.mode == "angle":
            reference = bench.position_gain * (reference - self.angle)
            reference = min(max(reference, -bench.speed_limit), bench.speed_limit)
        velocity_error = reference - self.velocity
        current_per_acceleration = self.parameters.rotor_inertia / self.parameters.torque_constant
        self._integral += current_per_acceleration * bench.velocity_integral * TICK * velocity_error
        unlimited_current = current_per_acceleration * bench.velocity_gain * velocity_error + self._integral
        limited_current = min(max(unlimited_current, -bench.peak_current), bench.peak_current)
        self._integral += (limited_current - unlimited_current) * bench.velocity_integral / bench.velocity_gain * TICK
        return limited_current

    @property
    def current(self) -> float:
        """Q-axis current as the drive's sensor reads it [A]."""
        return float(self._rig.plant.current_sensed[self._row, 0])

    @property
    def current_true(self) -> float:
        """True q-axis current [A]."""
        return float(self._rig.plant.current[self._row, 0])

    @property
    def voltage(self) -> float:
        """Mean q-axis voltage over the last millisecond [V]."""
        return float(self._rig.plant.voltage_mean[self._row, 0])

    @property
    def velocity_true(self) -> float:
        """True velocity of the rotor [rad/s]."""
        return float(self._rig.plant.velocity[self._row, 0])

    @property
    def velocity(self) -> float:
        """Filtered velocity that the drive reports [rad/s]."""
        return float(self._rig.plant.velocity_read[self._row, 0])

    @property
    def angle(self) -> float:
        """Angle as the encoder reads it, not rounded to counts [rad]."""
        plant = self._rig.plant
        return float(plant.angle_read[0] if self._row == 0 else plant.angle[1, 0])

    @property
    def winding_temperature(self) -> float:
        """Winding temperature as the camera reads it [degC]; the load's is not simulated and stays at ambient."""
        return self._camera_reading(0)

    @property
    def housing_temperature(self) -> float:
        """Housing temperature as the camera reads it [degC]."""
        return self._camera_reading(1)

    def _camera_reading(self, row: int) -> float:
        """Return the reading [degC] of winding (row 0) or housing (row 1)."""
        if self._row == 1:
            return self._rig.bench.ambient_temperature
        return float(self._rig.plant.thermal.camera()[row, 0])
