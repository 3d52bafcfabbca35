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

TICK = 1e-3  # s, of drives and records
SUBSTEPS = 10
STEP = TICK / SUBSTEPS


class SteppedPlant:
    """Benches side by side; arrays over actuators have the test actuator in row 0, the load in row 1.

    `advance` steps one millisecond. After it `angle`, `velocity`, `current` hold for the end of the millisecond;
    `current_mean` and `voltage_mean` are means over it; `velocity_read` and `torque_read` are the filtered readings.
    """

    def __init__(self, lanes: Sequence[Lane]) -> None:
        self.lanes, self.time, count = tuple(lanes), 0.0, len(lanes)
        self._bound = bound = bind(lanes)
        self.thermal = ThermalLanes(lanes, bound)
        self._take_parameters()
        both = (2, count)
        self.velocity, self.current = np.zeros(both), np.zeros(both)
        self.current_mean, self.voltage_mean = np.zeros(both), np.zeros(both)
        self.velocity_read, self.torque_read = np.zeros(both), np.zeros(count)
        self.angle = np.array([[lane.angle for lane in lanes]] * 2)
        self.bus_voltage = self._source.copy()
        self._ahead = self.angle.copy()  # angle half a sub-step ahead
        self._filtered, self._sensed = np.zeros(both), np.zeros(count)
        self._free, self._loss, self._net = np.zeros(both), np.zeros(both), np.zeros(both)
        self._target, self._change, self._middle = np.zeros(both), np.zeros(both), np.zeros(both)
        self._reference, self._twist, self._shaft = np.zeros(both), np.zeros(count), np.zeros(count)
        self._means, self._shafts = np.zeros((SUBSTEPS, *both)), np.zeros((SUBSTEPS, count))  # of a millisecond
        self._constants = np.ones(both)  # magnets' share
        self._scratch, self._line = np.zeros(both), np.zeros(count)
        self._lane_states: list[Now] = []
        self._make_views()

    def _take_parameters(self) -> None:
        lanes, bound = self.lanes, self._bound
        self._resistance_cold = rows(lanes, lambda p: p.phase_resistance)
        self._coefficient = rows(lanes, lambda p: p.resistance_coefficient)
        self._reference_temperature = rows(lanes, lambda p: p.reference_temperature)
        self._inductance = rows(lanes, lambda p: p.phase_inductance)
        self._torque_constant = rows(lanes, lambda p: p.torque_constant)
        self._back_emf = rows(lanes, lambda p: p.back_emf_constant)
        self._damping = rows(lanes, lambda p: p.viscous_damping)
        self._coulomb = rows(lanes, lambda p: p.coulomb_friction)
        self._inertia = inertia = rows(lanes, lambda p: p.rotor_inertia)
        self._mobility = STEP / inertia  # rad/s per N*m
        self._mobility[1, [lane.setup == "locked" for lane in lanes]] = 0.0
        stiffness = column(lanes, lambda lane: lane.bench.shaft_stiffness)
        for group in bound["shaft_stiffness"]:
            stiffness[group.lanes] = group.effect.shaft_stiffness(stiffness[group.lanes])
        stiffness *= [lane.setup in ("coupled", "locked") for lane in lanes]
        reduced = inertia[0] * inertia[1] / inertia.sum(axis=0)
        ratio = column(lanes, lambda lane: lane.bench.shaft_damping_ratio)
        self._stiffness, self._shaft_damping = stiffness, 2.0 * ratio * np.sqrt(stiffness * reduced)
        self._source = column(lanes, lambda lane: lane.bench.bus_voltage)
        self._lead_amplitude = rows(lanes, lambda p: p.lead_amplitude)
        self.current_offset, self.current_gain = np.zeros(inertia.shape), np.ones(inertia.shape)
        for group in bound["sense_current"]:
            zero = group.effect.sense_current(0.0)
            slope = group.effect.sense_current(1.0) - zero
            offset, gain = group.view(self.current_offset), group.view(self.current_gain)
            offset[:] = slope * offset + zero
            gain[:] *= slope
        self._loop = 2.0 * math.pi * column(lanes, lambda lane: lane.bench.current_loop_bandwidth) * self.current_gain
        self._approach = -np.expm1(-self._loop * STEP)
        # of a current's deviation from its target, at the start of a millisecond and after each sub-step
        self._deviation_share = np.exp(-self._loop * STEP * np.arange(SUBSTEPS + 1).reshape(-1, 1, 1))
        self._velocity_filter = _Filter(column(lanes, lambda lane: lane.bench.velocity_filter_bandwidth))
        self._torque_filter = _Filter(column(lanes, lambda lane: lane.bench.torque_filter_bandwidth))

    def _make_views(self) -> None:
        """Create the views of the state that each effect reads, and the filters of effects with a memory."""
        bound = self._bound
        for group in {id(group.now): group for members in bound.values() for group in members}.values():
            now, span = group.now, group.lanes
            now.angle, now.velocity, now.current = (
                group.view(self._ahead),
                group.view(self._free),
                group.view(self._middle),
            )
            now.shaft_torque, now.winding, now.housing = (
                self._shaft[span],
                self.thermal.winding[span],
                self.thermal.housing[span],
            )
            self._lane_states.append(now)
        self._net_of_test, self._net_of_load = self._net
        made = [(group, group.effect.reference_path(group.width, STEP)) for group in bound["reference_path"]]
        self._reference_paths = [(group, path) for group, path in made if path]
        made = [(group, group.effect.velocity_path(group.width, STEP)) for group in bound["velocity_path"]]
        self._velocity_paths = [(group, path) for group, path in made if path]
        made = [(group, group.effect.torque_path(group.width, STEP)) for group in bound["torque_path"]]
        self._torque_paths = [(group, path) for group, path in made if path]
        forms = [(group, group.effect.friction_path(group.width, STEP)) for group in bound["friction_path"]]
        self._friction_paths = [(group, form) for group, form in forms if form]
        torques = [(group, group.effect.rotor_path(group.width, STEP)) for group in bound["rotor_path"]]
        self._rotor_paths = [(group, torque) for group, torque in torques if torque]
        self._encoder_errors = [
            (group, np.asarray(group.effect.encoder_error(group.view(self._ahead)))) for group in bound["encoder_error"]
        ]

    # ---------------------------------------------------------------- time

    def advance(self, reference: Value) -> None:
        """Advance by one millisecond with these q-axis current references [A] for both actuators."""
        self._reference[:] = reference
        for group in self._bound["bounded_reference"]:
            allowed = group.effect.bounded_reference
            group.view(self._reference)[:] = allowed(
                group.view(self._reference), group.view(self._torque_constant), group.view(self.velocity)
            )
        np.divide(self._reference - self.current_offset, self.current_gain, out=self._target)
        self._refresh()
        start, before = self.current.copy(), self.angle.copy()
        if self._near_ceiling():
            self.current_mean[:] = 0.0
            for k in range(SUBSTEPS):
                self._follow()
                self._step(k)
            self.current_mean /= SUBSTEPS
        else:
            for k, middle in enumerate(self._followed()):
                np.copyto(self._middle, middle)
                self._step(k)
        if not self._velocity_paths:
            self._velocity_filter.pass_all(self._means, self._filtered)
        if not self._torque_paths:
            self._torque_filter.pass_all(self._shafts, self._sensed)
        np.subtract(self._ahead, 0.5 * STEP * self.velocity, out=self.angle)
        self._measure(start, before)
        self._warm((self.angle[0] - before[0]) / TICK)
        self.time += TICK

    def supply(self, voltage: float) -> None:
        """Set the source voltage [V] of every lane from now on."""
        self._source[:] = self.bus_voltage[:] = voltage

    def _refresh(self) -> None:
        """Update the parameters that change with temperature and time, once a millisecond."""
        for now in self._lane_states:
            now.time = self.time
        temperature = np.stack([self.thermal.winding, self.thermal.logged_ambient])
        share = 1.0 + self._coefficient * (temperature - self._reference_temperature)
        self._resistance = self._resistance_cold * share
        for group in self._bound["resistance_share"]:
            group.view(self._resistance)[:] *= group.effect.resistance_share(group.now.winding, self.time)
        self._level, damping = self._coulomb.copy(), self._damping.copy()
        for group in self._bound["friction_share"]:
            friction = group.effect.friction_share(group.now)
            group.view(self._level)[:] *= friction
            group.view(damping)[:] *= friction
        for group in self._bound["magnet_share"]:
            group.view(self._constants)[:] = group.effect.magnet_share(group.now)
        self._drive = self._torque_constant * self._constants
        self._emf = self._back_emf * self._constants
        self._damped = 1.0 / (1.0 + self._mobility * damping)
        self._brake = self._mobility * self._damped  # rad/s per N*m of friction and sub-step
        for group, _ in self._friction_paths:  # their friction acts as a torque instead
            group.view(self._brake)[:] = 0.0
        np.multiply(self._level, self._brake, out=self._loss)
        self._level_now = self._level.copy()
        self._viscous = damping

    def _near_ceiling(self) -> bool:
        """Return whether the voltage could reach its ceiling in any lane within this millisecond."""
        jump = np.abs(self._target - self.current)
        most = np.maximum(np.abs(self._target), np.abs(self.current))
        needed = self._resistance * most + self._emf * np.abs(self.velocity) + self._loop * self._inductance * jump
        # 2 V: what acceleration within the millisecond, and a delayed reference, may add
        delayed = 0.0 if not self._reference_paths else math.inf
        return bool((needed + 2.0 + delayed > self.bus_voltage / self._lead_amplitude).any())

    def _followed(self) -> Array:
        """Currents in the middle of each sub-step of this millisecond, for loops that reach no voltage ceiling."""
        currents = self._target + (self.current - self._target) * self._deviation_share
        np.copyto(self.current, currents[-1])
        middles: Array = 0.5 * (currents[:-1] + currents[1:])
        np.mean(middles, axis=0, out=self.current_mean)
        return middles

    def _follow(self) -> None:
        """Advance the currents by a sub-step, within the voltage ceiling."""
        current, change, middle = self.current, self._change, self._middle
        for group, path in self._reference_paths:
            followed = path(group.view(self._reference))
            group.view(self._target)[:] = (followed - group.view(self.current_offset)) / group.view(self.current_gain)
        np.subtract(self._target, current, out=change)
        change *= self._approach
        self._limit_voltage()
        np.multiply(change, 0.5, out=middle)
        middle += current
        current += change
        self.current_mean += middle

    def _step(self, index: int) -> None:
        """Advance the mechanics by a sub-step; `index` is its number within the millisecond."""
        net, free, velocity, ahead, scratch = self._net, self._free, self.velocity, self._ahead, self._scratch
        np.multiply(self._drive, self._middle, out=net)
        for group in self._bound["torque_share"]:
            group.view(net)[:] *= group.effect.torque_share(group.now)
        self._strain(index)
        self._net_of_test -= self._shaft
        self._net_of_load += self._shaft
        for group in self._bound["torque"]:
            group.view(net)[:] += group.effect.torque(group.now.angle, group.view(velocity))
        for group, torque in self._rotor_paths:
            group.view(net)[:] += torque(group.now)
        for group, form in self._friction_paths:
            group.view(net)[:] += form(group.view(self._level_now), group.view(velocity))

        np.multiply(net, self._mobility, out=free)
        free += velocity
        free *= self._damped
        self._raise_friction()
        np.abs(free, out=scratch)
        scratch -= self._loss
        np.maximum(scratch, 0.0, out=scratch)
        np.copysign(scratch, free, out=free)
        mean = self._means[index]
        np.add(velocity, free, out=mean)
        np.copyto(velocity, free)
        mean *= 0.5
        self._sense_velocity(mean)
        np.multiply(velocity, STEP, out=scratch)
        ahead += scratch

    def _limit_voltage(self) -> None:
        """Reduce the change of current to what the voltage ceiling allows."""
        ceiling = self.bus_voltage / self._lead_amplitude
        per_step = self._inductance / STEP + 0.5 * self._resistance
        velocity = self.velocity + 0.5 * self._mobility * self._net  # half way, by the last step's torque
        needed = self._resistance * self.current + self._emf * velocity + per_step * self._change
        self._change -= (needed - np.clip(needed, -ceiling, ceiling)) / per_step

    def _strain(self, index: int) -> None:
        """Compute the shaft's torque; filter the sensor's torque too if an effect acts on the filtered torque."""
        twist, shaft, line = self._twist, self._shaft, self._line
        np.subtract(self._ahead[0], self._ahead[1], out=twist)
        np.subtract(self.velocity[0], self.velocity[1], out=line)
        for group in self._bound["transmitted_twist"]:
            twist[group.lanes] = group.effect.transmitted_twist(twist[group.lanes])
            line[group.lanes] *= twist[group.lanes] != 0.0
        np.multiply(self._stiffness, twist, out=shaft)
        line *= self._shaft_damping
        shaft += line
        np.copyto(self._shafts[index], shaft)
        if self._torque_paths:
            self._torque_filter.pass_one(shaft, self._sensed)
        for group, path in self._torque_paths:
            self.torque_read[group.lanes] = path(self._sensed[group.lanes])

    def _raise_friction(self) -> None:
        level: Value = None
        span: slice | None = None
        for group in self._bound["coulomb"]:
            if group.lanes != span:  # a second effect of one group changes the first one's level
                span, level = group.lanes, group.view(self._level)
            level = group.effect.coulomb(level, group.now)
            group.view(self._level_now)[:] = level
            group.view(self._loss)[:] = level * group.view(self._brake)

    def _sense_velocity(self, mean: Array) -> None:
        """Add the encoder's error to the velocity; filter it too if an effect acts on the filtered velocity."""
        for group, before in self._encoder_errors:
            error = group.effect.encoder_error(group.view(self._ahead))
            group.view(mean)[:] += (error - before) / STEP
            before[:] = error
        if self._velocity_paths:
            self._velocity_filter.pass_one(mean, self._filtered)
        for group, path in self._velocity_paths:
            group.view(self.velocity_read)[:] = path(group.view(self._filtered))

    # ---------------------------------------------------------------- readings

    def _measure(self, start: Array, before: Array) -> None:
        filtered_velocities = [(group, group.view(self.velocity_read).copy()) for group, _ in self._velocity_paths]
        np.copyto(self.velocity_read, self._filtered)
        for group, reading in filtered_velocities:
            group.view(self.velocity_read)[:] = reading
        filtered_torques = [(group, self.torque_read[group.lanes].copy()) for group, _ in self._torque_paths]
        np.copyto(self.torque_read, self._sensed)
        for group, reading in filtered_torques:
            self.torque_read[group.lanes] = reading
        for group in self._bound["sense_torque"]:
            self.torque_read[group.lanes] = group.effect.sense_torque(self.torque_read[group.lanes])
        voltage = self._resistance * self.current_mean + self._emf * (self.angle - before) / TICK
        voltage += self._inductance * (self.current - start) / TICK
        for group in self._bound["lost_voltage"]:
            lost, view = group.effect.lost_voltage, group.view
            group.view(voltage)[:] += (
                lost(view(start)) + 4.0 * lost(view(self.current_mean)) + lost(view(self.current))
            ) / 6.0
        self.voltage_mean[:] = voltage
        for group in self._bound["bus_voltage"]:
            power = group.view(voltage) * group.view(self.current_mean)
            self.bus_voltage[group.lanes] = group.effect.bus_voltage(self._source[group.lanes], power)

    def _warm(self, speed: Array) -> None:
        heat = self._resistance[0] * self.current_mean[0] ** 2
        friction = self._line
        if self.thermal.needs_friction:
            friction = self._viscous[0] * speed**2 + self._level[0] * np.abs(speed)
        self.thermal.step(self.time, TICK, heat, speed, friction)

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
        total: Array = kinetic.sum(axis=0) + 0.5 * self._stiffness * (self.angle[0] - self.angle[1]) ** 2
        return total


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

        values : (sub-steps, ..., lanes).
        """
        output *= self._decay
        output += np.einsum("kl,k...l->...l", self._weights, values)
