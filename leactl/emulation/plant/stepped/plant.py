"""The stepped plant: many benches at once, in fixed sub-steps of 0.1 ms, with every effect of the vocabulary.

Currents follow the first-order loop exactly within a sub-step. Where no effect or ceiling acts within a millisecond,
the current loops and the sensors' filters are computed for all its sub-steps at once. The mechanics use the leap-frog
scheme: angles are half a sub-step ahead of velocities, which keeps the shaft's resonance (360 Hz, 0.22 rad a sub-step)
at its frequency to 0.2 % and conserves its energy. Friction reduces the velocity that results without friction, and
never reverses it; a velocity reduced to zero is sticking.
"""

import math
from collections.abc import Sequence

import numpy as np

from leactl.emulation.plant.effects.contract import Now, Value
from leactl.emulation.plant.stepped.lanes import Array, Lane, bind, column, rows
from leactl.emulation.plant.stepped.thermal import ThermalLanes

TICK = 1e-3  # s, period of the drives and of the records
SUBSTEPS = 10
STEP = TICK / SUBSTEPS  # s


class SteppedPlant:
    """Benches side by side; arrays over actuators have the test actuator in row 0, the load in row 1.

    `advance` steps one millisecond. After it `angle`, `velocity` and `current` are those of the millisecond's end;
    `current_mean` and `voltage_mean` are means over it; `velocity_read` and `torque_read` are the filtered readings.
    """

    def __init__(self, lanes: Sequence[Lane]) -> None:
        self.lanes, self.time, lane_count = tuple(lanes), 0.0, len(lanes)
        self._groups_by_hook = groups_by_hook = bind(lanes)
        self.thermal = ThermalLanes(lanes, groups_by_hook)
        self._take_parameters()
        shape = (2, lane_count)
        self.velocity, self.current = np.zeros(shape), np.zeros(shape)
        self.current_mean, self.voltage_mean = np.zeros(shape), np.zeros(shape)
        self.velocity_read, self.torque_read = np.zeros(shape), np.zeros(lane_count)
        self.angle = np.array([[lane.angle for lane in lanes]] * 2)
        self.bus_voltage = self._source_voltage.copy()
        self._leading_angle = self.angle.copy()  # half a sub-step ahead of the velocity
        self._filtered_velocity, self._filtered_torque = np.zeros(shape), np.zeros(lane_count)
        self._free_velocity, self._friction_loss, self._net_torque = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self._target, self._current_change, self._mid_current = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self._reference, self._shaft_twist, self._shaft_torque = (
            np.zeros(shape),
            np.zeros(lane_count),
            np.zeros(lane_count),
        )
        self._substep_velocities, self._substep_torques = np.zeros((SUBSTEPS, *shape)), np.zeros((SUBSTEPS, lane_count))
        self._magnet_shares = np.ones(shape)
        self._scratch_pair, self._scratch_lane = np.zeros(shape), np.zeros(lane_count)
        self._lane_states: list[Now] = []
        self._make_views()

    def _take_parameters(self) -> None:
        """Collect the parameters of all lanes in arrays, with the effects that change them once and for all."""
        lanes, groups_by_hook = self.lanes, self._groups_by_hook
        self._reference_resistance = rows(lanes, lambda p: p.phase_resistance)
        self._resistance_coefficient = rows(lanes, lambda p: p.resistance_coefficient)
        self._reference_temperature = rows(lanes, lambda p: p.reference_temperature)
        self._inductance = rows(lanes, lambda p: p.phase_inductance)
        self._torque_constant = rows(lanes, lambda p: p.torque_constant)
        self._back_emf_constant = rows(lanes, lambda p: p.back_emf_constant)
        self._nominal_damping = rows(lanes, lambda p: p.viscous_damping)
        self._nominal_coulomb = rows(lanes, lambda p: p.coulomb_friction)
        self._inertia = inertia = rows(lanes, lambda p: p.rotor_inertia)
        self._speed_per_torque = STEP / inertia  # rad/s per N*m
        self._speed_per_torque[1, [lane.setup == "locked" for lane in lanes]] = 0.0
        stiffness = column(lanes, lambda lane: lane.bench.shaft_stiffness)
        for group in groups_by_hook["shaft_stiffness"]:
            stiffness[group.lanes] = group.effect.shaft_stiffness(stiffness[group.lanes])
        stiffness *= [lane.setup in ("coupled", "locked") for lane in lanes]
        reduced_inertia = inertia[0] * inertia[1] / inertia.sum(axis=0)
        damping_ratio = column(lanes, lambda lane: lane.bench.shaft_damping_ratio)
        self._stiffness, self._shaft_damping = stiffness, 2.0 * damping_ratio * np.sqrt(stiffness * reduced_inertia)
        self._source_voltage = column(lanes, lambda lane: lane.bench.bus_voltage)
        self._lead_amplitude = rows(lanes, lambda p: p.lead_amplitude)
        self.current_offset, self.current_gain = np.zeros(inertia.shape), np.ones(inertia.shape)
        for group in groups_by_hook["sense_current"]:
            reading_at_zero = group.effect.sense_current(0.0)
            slope = group.effect.sense_current(1.0) - reading_at_zero
            offset, gain = group.view(self.current_offset), group.view(self.current_gain)
            offset[:] = slope * offset + reading_at_zero
            gain[:] *= slope
        self._loop_rate = (
            2.0 * math.pi * column(lanes, lambda lane: lane.bench.current_loop_bandwidth) * self.current_gain
        )
        self._substep_share = -np.expm1(-self._loop_rate * STEP)
        # share of a current's first deviation from its target at the start of a millisecond and after each sub-step
        self._deviation_share = np.exp(-self._loop_rate * STEP * np.arange(SUBSTEPS + 1).reshape(-1, 1, 1))
        self._velocity_filter = _Filter(column(lanes, lambda lane: lane.bench.velocity_filter_bandwidth))
        self._torque_filter = _Filter(column(lanes, lambda lane: lane.bench.torque_filter_bandwidth))

    def _make_views(self) -> None:
        """Create the views of the state that each effect reads, and the filters of effects with a memory."""
        groups_by_hook = self._groups_by_hook
        for group in {id(group.now): group for groups in groups_by_hook.values() for group in groups}.values():
            now, lane_slice = group.now, group.lanes
            now.angle, now.velocity, now.current = (
                group.view(self._leading_angle),
                group.view(self._free_velocity),
                group.view(self._mid_current),
            )
            now.shaft_torque, now.winding, now.housing = (
                self._shaft_torque[lane_slice],
                self.thermal.winding[lane_slice],
                self.thermal.housing[lane_slice],
            )
            self._lane_states.append(now)
        self._net_torque_of_test, self._net_torque_of_load = self._net_torque
        paths = [(group, group.effect.reference_path(group.width, STEP)) for group in groups_by_hook["reference_path"]]
        self._reference_paths = [(group, path) for group, path in paths if path]
        paths = [(group, group.effect.velocity_path(group.width, STEP)) for group in groups_by_hook["velocity_path"]]
        self._velocity_paths = [(group, path) for group, path in paths if path]
        paths = [(group, group.effect.torque_path(group.width, STEP)) for group in groups_by_hook["torque_path"]]
        self._torque_paths = [(group, path) for group, path in paths if path]
        forms = [(group, group.effect.friction_path(group.width, STEP)) for group in groups_by_hook["friction_path"]]
        self._friction_paths = [(group, form) for group, form in forms if form]
        torques = [(group, group.effect.rotor_path(group.width, STEP)) for group in groups_by_hook["rotor_path"]]
        self._rotor_paths = [(group, torque) for group, torque in torques if torque]
        self._encoder_errors = [
            (group, np.asarray(group.effect.encoder_error(group.view(self._leading_angle))))
            for group in groups_by_hook["encoder_error"]
        ]

    # ---------------------------------------------------------------- time

    def advance(self, reference: Value) -> None:
        """Advance by one millisecond with these q-axis current references [A] for both actuators."""
        self._reference[:] = reference
        for group in self._groups_by_hook["bounded_reference"]:
            bounded_reference = group.effect.bounded_reference
            group.view(self._reference)[:] = bounded_reference(
                group.view(self._reference), group.view(self._torque_constant), group.view(self.velocity)
            )
        np.divide(self._reference - self.current_offset, self.current_gain, out=self._target)
        self._refresh()
        start_current, start_angle = self.current.copy(), self.angle.copy()
        if self._near_ceiling():
            self.current_mean[:] = 0.0
            for k in range(SUBSTEPS):
                self._step_currents()
                self._step_mechanics(k)
            self.current_mean /= SUBSTEPS
        else:
            for k, middle_current in enumerate(self._currents_without_ceiling()):
                np.copyto(self._mid_current, middle_current)
                self._step_mechanics(k)
        if not self._velocity_paths:
            self._velocity_filter.pass_all(self._substep_velocities, self._filtered_velocity)
        if not self._torque_paths:
            self._torque_filter.pass_all(self._substep_torques, self._filtered_torque)
        np.subtract(self._leading_angle, 0.5 * STEP * self.velocity, out=self.angle)
        self._measure(start_current, start_angle)
        self._warm((self.angle[0] - start_angle[0]) / TICK)
        self.time += TICK

    def supply(self, voltage: float) -> None:
        """Set the source voltage [V] of every lane from now on."""
        self._source_voltage[:] = self.bus_voltage[:] = voltage

    def _refresh(self) -> None:
        """Update the parameters that change with temperature and time, once a millisecond."""
        for now in self._lane_states:
            now.time = self.time
        temperature = np.stack([self.thermal.winding, self.thermal.logged_ambient])
        resistance_factor = 1.0 + self._resistance_coefficient * (temperature - self._reference_temperature)
        self._resistance = self._reference_resistance * resistance_factor
        for group in self._groups_by_hook["resistance_share"]:
            group.view(self._resistance)[:] *= group.effect.resistance_share(group.now.winding, self.time)
        self._coulomb_level, damping = self._nominal_coulomb.copy(), self._nominal_damping.copy()
        for group in self._groups_by_hook["friction_share"]:
            friction_factor = group.effect.friction_share(group.now)
            group.view(self._coulomb_level)[:] *= friction_factor
            group.view(damping)[:] *= friction_factor
        for group in self._groups_by_hook["magnet_share"]:
            group.view(self._magnet_shares)[:] = group.effect.magnet_share(group.now)
        self._torque_per_current = self._torque_constant * self._magnet_shares
        self._voltage_per_speed = self._back_emf_constant * self._magnet_shares
        self._damping_factor = 1.0 / (1.0 + self._speed_per_torque * damping)
        # rad/s that a sub-step takes off for each N*m of friction
        self._speed_loss_per_torque = self._speed_per_torque * self._damping_factor
        for group, _ in self._friction_paths:  # their friction is a torque in _step_mechanics instead
            group.view(self._speed_loss_per_torque)[:] = 0.0
        np.multiply(self._coulomb_level, self._speed_loss_per_torque, out=self._friction_loss)
        self._substep_level = self._coulomb_level.copy()
        self._viscous_damping = damping

    def _near_ceiling(self) -> bool:
        """Return whether the voltage could reach its ceiling in any lane within this millisecond."""
        current_jump = np.abs(self._target - self.current)
        highest_current = np.maximum(np.abs(self._target), np.abs(self.current))
        needed_voltage = (
            self._resistance * highest_current
            + self._voltage_per_speed * np.abs(self.velocity)
            + self._loop_rate * self._inductance * current_jump
        )
        # 2 V for acceleration within the millisecond; a delayed reference may need any voltage
        delayed_voltage = 0.0 if not self._reference_paths else math.inf
        return bool((needed_voltage + 2.0 + delayed_voltage > self.bus_voltage / self._lead_amplitude).any())

    def _currents_without_ceiling(self) -> Array:
        """Advance the currents by a millisecond without a ceiling; return those in the middle of each sub-step."""
        currents = self._target + (self.current - self._target) * self._deviation_share
        np.copyto(self.current, currents[-1])
        middle_currents: Array = 0.5 * (currents[:-1] + currents[1:])
        np.mean(middle_currents, axis=0, out=self.current_mean)
        return middle_currents

    def _step_currents(self) -> None:
        """Advance the currents by a sub-step, within the voltage ceiling."""
        current, current_change, middle_current = self.current, self._current_change, self._mid_current
        for group, path in self._reference_paths:
            delayed_reference = path(group.view(self._reference))
            group.view(self._target)[:] = (delayed_reference - group.view(self.current_offset)) / group.view(
                self.current_gain
            )
        np.subtract(self._target, current, out=current_change)
        current_change *= self._substep_share
        self._limit_voltage()
        np.multiply(current_change, 0.5, out=middle_current)
        middle_current += current
        current += current_change
        self.current_mean += middle_current

    def _step_mechanics(self, index: int) -> None:
        """Advance the mechanics by a sub-step; `index` is its number within the millisecond."""
        net_torque, free_velocity, velocity, leading_angle, scratch_pair = (
            self._net_torque,
            self._free_velocity,
            self.velocity,
            self._leading_angle,
            self._scratch_pair,
        )
        np.multiply(self._torque_per_current, self._mid_current, out=net_torque)
        for group in self._groups_by_hook["torque_share"]:
            group.view(net_torque)[:] *= group.effect.torque_share(group.now)
        self._strain_shaft(index)
        self._net_torque_of_test -= self._shaft_torque
        self._net_torque_of_load += self._shaft_torque
        for group in self._groups_by_hook["torque"]:
            group.view(net_torque)[:] += group.effect.torque(group.now.angle, group.view(velocity))
        for group, rotor_torque in self._rotor_paths:
            group.view(net_torque)[:] += rotor_torque(group.now)
        for group, friction_torque in self._friction_paths:
            group.view(net_torque)[:] += friction_torque(group.view(self._substep_level), group.view(velocity))

        np.multiply(net_torque, self._speed_per_torque, out=free_velocity)
        free_velocity += velocity
        free_velocity *= self._damping_factor
        self._raise_friction()
        np.abs(free_velocity, out=scratch_pair)
        scratch_pair -= self._friction_loss
        np.maximum(scratch_pair, 0.0, out=scratch_pair)
        np.copysign(scratch_pair, free_velocity, out=free_velocity)
        mean_velocity = self._substep_velocities[index]
        np.add(velocity, free_velocity, out=mean_velocity)
        np.copyto(velocity, free_velocity)
        mean_velocity *= 0.5
        self._sense_velocity(mean_velocity)
        np.multiply(velocity, STEP, out=scratch_pair)
        leading_angle += scratch_pair

    def _limit_voltage(self) -> None:
        """Reduce the change of current to what the voltage ceiling allows."""
        ceiling = self.bus_voltage / self._lead_amplitude
        voltage_per_change = self._inductance / STEP + 0.5 * self._resistance
        # in the middle of the sub-step, by the torque of the one before
        velocity = self.velocity + 0.5 * self._speed_per_torque * self._net_torque
        needed_voltage = (
            self._resistance * self.current
            + self._voltage_per_speed * velocity
            + voltage_per_change * self._current_change
        )
        self._current_change -= (needed_voltage - np.clip(needed_voltage, -ceiling, ceiling)) / voltage_per_change

    def _strain_shaft(self, index: int) -> None:
        """Compute the shaft's torque; filter the sensor's torque too if an effect acts on the filtered torque."""
        twist, shaft_torque, damping_torque = self._shaft_twist, self._shaft_torque, self._scratch_lane
        np.subtract(self._leading_angle[0], self._leading_angle[1], out=twist)
        np.subtract(self.velocity[0], self.velocity[1], out=damping_torque)
        for group in self._groups_by_hook["transmitted_twist"]:
            twist[group.lanes] = group.effect.transmitted_twist(twist[group.lanes])
            damping_torque[group.lanes] *= twist[group.lanes] != 0.0
        np.multiply(self._stiffness, twist, out=shaft_torque)
        damping_torque *= self._shaft_damping
        shaft_torque += damping_torque
        np.copyto(self._substep_torques[index], shaft_torque)
        if self._torque_paths:
            self._torque_filter.pass_one(shaft_torque, self._filtered_torque)
        for group, path in self._torque_paths:
            self.torque_read[group.lanes] = path(self._filtered_torque[group.lanes])

    def _raise_friction(self) -> None:
        """Replace the Coulomb friction of this sub-step by that of the effects, one after the other."""
        level: Value = None
        level_lanes: slice | None = None
        for group in self._groups_by_hook["coulomb"]:
            if group.lanes != level_lanes:  # a second effect of one group changes the first one's level
                level_lanes, level = group.lanes, group.view(self._coulomb_level)
            level = group.effect.coulomb(level, group.now)
            group.view(self._substep_level)[:] = level
            group.view(self._friction_loss)[:] = level * group.view(self._speed_loss_per_torque)

    def _sense_velocity(self, velocity: Array) -> None:
        """Add the encoder's error to the velocity; filter it too if an effect acts on the filtered velocity."""
        for group, previous_error in self._encoder_errors:
            error = group.effect.encoder_error(group.view(self._leading_angle))
            group.view(velocity)[:] += (error - previous_error) / STEP
            previous_error[:] = error
        if self._velocity_paths:
            self._velocity_filter.pass_one(velocity, self._filtered_velocity)
        for group, path in self._velocity_paths:
            group.view(self.velocity_read)[:] = path(group.view(self._filtered_velocity))

    # ---------------------------------------------------------------- readings

    def _measure(self, start_current: Array, start_angle: Array) -> None:
        """Compute the readings and voltages of a millisecond that began with these currents [A] and angles [rad]."""
        filtered_velocities = [(group, group.view(self.velocity_read).copy()) for group, _ in self._velocity_paths]
        np.copyto(self.velocity_read, self._filtered_velocity)
        for group, reading in filtered_velocities:
            group.view(self.velocity_read)[:] = reading
        filtered_torques = [(group, self.torque_read[group.lanes].copy()) for group, _ in self._torque_paths]
        np.copyto(self.torque_read, self._filtered_torque)
        for group, reading in filtered_torques:
            self.torque_read[group.lanes] = reading
        for group in self._groups_by_hook["sense_torque"]:
            self.torque_read[group.lanes] = group.effect.sense_torque(self.torque_read[group.lanes])
        voltage = self._resistance * self.current_mean + self._voltage_per_speed * (self.angle - start_angle) / TICK
        voltage += self._inductance * (self.current - start_current) / TICK
        for group in self._groups_by_hook["lost_voltage"]:
            lost_voltage, view = group.effect.lost_voltage, group.view
            group.view(voltage)[:] += (
                lost_voltage(view(start_current))
                + 4.0 * lost_voltage(view(self.current_mean))
                + lost_voltage(view(self.current))
            ) / 6.0
        self.voltage_mean[:] = voltage
        for group in self._groups_by_hook["bus_voltage"]:
            power = group.view(voltage) * group.view(self.current_mean)
            self.bus_voltage[group.lanes] = group.effect.bus_voltage(self._source_voltage[group.lanes], power)

    def _warm(self, speed: Array) -> None:
        """Step the temperatures by a millisecond at mean speeds of the test actuators [rad/s]."""
        heat = self._resistance[0] * self.current_mean[0] ** 2
        friction_power = self._scratch_lane
        if self.thermal.needs_friction:
            friction_power = self._viscous_damping[0] * speed**2 + self._coulomb_level[0] * np.abs(speed)
        self.thermal.step(self.time, TICK, heat, speed, friction_power)

    @property
    def angle_read(self) -> Array:
        """Angles of the test actuators as their encoders read them, not rounded to counts [rad]."""
        angle: Array = self.angle[0]
        if self._encoder_errors:
            angle = angle.copy()
            for group, _ in self._encoder_errors:
                angle[group.lanes] += group.effect.encoder_error(angle[group.lanes])
        return angle

    @property
    def current_sensed(self) -> Array:
        """Currents at the end of the millisecond as the drives' sensors read them [A]."""
        return self.current_gain * self.current + self.current_offset

    @property
    def current_mean_sensed(self) -> Array:
        """Mean currents over the millisecond as the drives' sensors read them [A]."""
        return self.current_gain * self.current_mean + self.current_offset

    @property
    def kinetic_and_strain_energy(self) -> Array:
        """Kinetic energy of the rotors plus strain energy of the shaft [J], shape (lanes,)."""
        kinetic = 0.5 * self._inertia * self.velocity**2
        energy: Array = kinetic.sum(axis=0) + 0.5 * self._stiffness * (self.angle[0] - self.angle[1]) ** 2
        return energy


class _Filter:
    """A first-order sensor filter in each lane, whose input is constant over a sub-step."""

    def __init__(self, bandwidth: Array) -> None:
        rate = 2.0 * math.pi * bandwidth * STEP
        self._gain, self._decay = -np.expm1(-rate), np.exp(-rate * SUBSTEPS)
        self._weights = self._gain * np.exp(-rate * np.arange(SUBSTEPS - 1, -1, -1).reshape(-1, 1))

    def pass_one(self, value: Array, output: Array) -> None:
        """Advance the output by a sub-step."""
        output += self._gain * (value - output)

    def pass_all(self, values: Array, output: Array) -> None:
        """Advance the output by a millisecond.

        values : one for each sub-step, shape (sub-steps, ..., lanes).
        """
        output *= self._decay
        output += np.einsum("kl,k...l->...l", self._weights, values)
