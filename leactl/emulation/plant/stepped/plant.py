"""The stepped plant: many benches at once, in fixed sub-steps of 0.1 ms, with every effect of the vocabulary.

Currents follow the first-order loop exactly within a sub-step. Where nothing else acts on them, current loops and
sensors' filters are worked out for all sub-steps of a millisecond at once. The mechanics leap-frog: angles live half a
sub-step ahead of velocities, which keeps the shaft's resonance (360 Hz, 0.22 rad a sub-step) at its frequency to 0.2 %
and its energy for ever. Friction is taken off the free velocity and never turns it around: that is sticking.
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

    `advance` goes on by one millisecond. After it `angle`, `velocity`, `current` hold for its end, `current_mean` and
    `voltage_mean` for the millisecond, `velocity_read` and `torque_read` are behind the sensors' filters.
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
        self._slow: list[Now] = []
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
        for own in bound["shaft_stiffness"]:
            stiffness[own.lanes] = own.effect.shaft_stiffness(stiffness[own.lanes])
        stiffness *= [lane.setup in ("coupled", "locked") for lane in lanes]
        reduced = inertia[0] * inertia[1] / inertia.sum(axis=0)
        ratio = column(lanes, lambda lane: lane.bench.shaft_damping_ratio)
        self._stiffness, self._shaft_damping = stiffness, 2.0 * ratio * np.sqrt(stiffness * reduced)
        self._source = column(lanes, lambda lane: lane.bench.bus_voltage)
        self._lead_amplitude = rows(lanes, lambda p: p.lead_amplitude)
        self.current_offset, self.current_gain = np.zeros(inertia.shape), np.ones(inertia.shape)
        for own in bound["sense_current"]:
            zero = own.effect.sense_current(0.0)
            own.of(self.current_offset)[:] = zero + own.of(self.current_gain) * 0.0
            own.of(self.current_gain)[:] *= own.effect.sense_current(1.0) - zero
        self._loop = 2.0 * math.pi * column(lanes, lambda lane: lane.bench.current_loop_bandwidth) * self.current_gain
        self._approach = -np.expm1(-self._loop * STEP)
        # of a current's deviation from its target, at the start of a millisecond and after each sub-step
        self._share_left = np.exp(-self._loop * STEP * np.arange(SUBSTEPS + 1).reshape(-1, 1, 1))
        self._velocity_filter = _Filter(column(lanes, lambda lane: lane.bench.velocity_filter_bandwidth))
        self._torque_filter = _Filter(column(lanes, lambda lane: lane.bench.torque_filter_bandwidth))

    def _make_views(self) -> None:
        """Views of the state for each effect, and the memories of those that have one."""
        bound = self._bound
        for own in {id(own.now): own for group in bound.values() for own in group}.values():
            now, at = own.now, own.lanes
            now.angle, now.velocity, now.current = own.of(self._ahead), own.of(self._free), own.of(self._middle)
            now.shaft_torque, now.winding, now.housing = (
                self._shaft[at],
                self.thermal.winding[at],
                self.thermal.housing[at],
            )
            self._slow.append(now)
        self._net_of_test, self._net_of_load = self._net
        made = [(own, own.effect.reference_path(own.width, STEP)) for own in bound["reference_path"]]
        self._reference_paths = [(own, path) for own, path in made if path]
        made = [(own, own.effect.velocity_path(own.width, STEP)) for own in bound["velocity_path"]]
        self._velocity_paths = [(own, path) for own, path in made if path]
        made = [(own, own.effect.torque_path(own.width, STEP)) for own in bound["torque_path"]]
        self._torque_paths = [(own, path) for own, path in made if path]
        forms = [(own, own.effect.friction_path(own.width, STEP)) for own in bound["friction_path"]]
        self._friction_paths = [(own, form) for own, form in forms if form]
        torques = [(own, own.effect.rotor_path(own.width, STEP)) for own in bound["rotor_path"]]
        self._rotor_paths = [(own, torque) for own, torque in torques if torque]
        self._encoder_errors = [
            (own, np.asarray(own.effect.encoder_error(own.of(self._ahead)))) for own in bound["encoder_error"]
        ]

    # ---------------------------------------------------------------- time

    def advance(self, reference: Value) -> None:
        """Go on by a millisecond with these q-axis current references [A] for both actuators."""
        self._reference[:] = reference
        for own in self._bound["bounded_reference"]:
            allowed = own.effect.bounded_reference
            own.of(self._reference)[:] = allowed(
                own.of(self._reference), own.of(self._torque_constant), own.of(self.velocity)
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
        """Have every lane's source give this voltage [V] from now on."""
        self._source[:] = self.bus_voltage[:] = voltage

    def _refresh(self) -> None:
        """What changes with temperature and time: once a millisecond."""
        for now in self._slow:
            now.time = self.time
        temperature = np.stack([self.thermal.winding, self.thermal.logged_ambient])
        share = 1.0 + self._coefficient * (temperature - self._reference_temperature)
        self._resistance = self._resistance_cold * share
        for own in self._bound["resistance_share"]:
            own.of(self._resistance)[:] *= own.effect.resistance_share(own.now.winding, self.time)
        self._level, damping = self._coulomb.copy(), self._damping.copy()
        for own in self._bound["friction_share"]:
            friction = own.effect.friction_share(own.now)
            own.of(self._level)[:] *= friction
            own.of(damping)[:] *= friction
        for own in self._bound["magnet_share"]:
            own.of(self._constants)[:] = own.effect.magnet_share(own.now)
        self._drive = self._torque_constant * self._constants
        self._emf = self._back_emf * self._constants
        self._damped = 1.0 / (1.0 + self._mobility * damping)
        self._brake = self._mobility * self._damped  # rad/s that one N*m of friction takes off in a sub-step
        for own, _ in self._friction_paths:  # theirs comes as a torque instead
            own.of(self._brake)[:] = 0.0
        np.multiply(self._level, self._brake, out=self._loss)
        self._level_now = self._level.copy()
        self._viscous = damping

    def _near_ceiling(self) -> bool:
        """Whether the voltage could reach its ceiling in any lane within this millisecond."""
        jump = np.abs(self._target - self.current)
        most = np.maximum(np.abs(self._target), np.abs(self.current))
        needed = self._resistance * most + self._emf * np.abs(self.velocity) + self._loop * self._inductance * jump
        # 2 V: what acceleration within the millisecond, and a delayed reference, may add
        delayed = 0.0 if not self._reference_paths else math.inf
        return bool((needed + 2.0 + delayed > self.bus_voltage / self._lead_amplitude).any())

    def _followed(self) -> Array:
        """Currents in the middle of each sub-step of this millisecond, of loops that no ceiling holds."""
        currents = self._target + (self.current - self._target) * self._share_left
        np.copyto(self.current, currents[-1])
        middles: Array = 0.5 * (currents[:-1] + currents[1:])
        np.mean(middles, axis=0, out=self.current_mean)
        return middles

    def _follow(self) -> None:
        """Take the currents on by a sub-step, under the ceiling of the voltage."""
        current, change, middle = self.current, self._change, self._middle
        for own, path in self._reference_paths:
            followed = path(own.of(self._reference))
            own.of(self._target)[:] = (followed - own.of(self.current_offset)) / own.of(self.current_gain)
        np.subtract(self._target, current, out=change)
        change *= self._approach
        self._limit_voltage()
        np.multiply(change, 0.5, out=middle)
        middle += current
        current += change
        self.current_mean += middle

    def _step(self, index: int) -> None:
        """Take the mechanics on by a sub-step, of this index in its millisecond."""
        net, free, velocity, ahead, scratch = self._net, self._free, self.velocity, self._ahead, self._scratch
        np.multiply(self._drive, self._middle, out=net)
        for own in self._bound["torque_share"]:
            own.of(net)[:] *= own.effect.torque_share(own.now)
        self._strain(index)
        self._net_of_test -= self._shaft
        self._net_of_load += self._shaft
        for own in self._bound["torque"]:
            own.of(net)[:] += own.effect.torque(own.now.angle, own.of(velocity))
        for own, torque in self._rotor_paths:
            own.of(net)[:] += torque(own.now)
        for own, form in self._friction_paths:
            own.of(net)[:] += form(own.of(self._level_now), own.of(velocity))

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
        """Take from the change of current what the ceiling does not allow."""
        ceiling = self.bus_voltage / self._lead_amplitude
        per_step = self._inductance / STEP + 0.5 * self._resistance
        velocity = self.velocity + 0.5 * self._mobility * self._net  # half way, by the last step's torque
        needed = self._resistance * self.current + self._emf * velocity + per_step * self._change
        self._change -= (needed - np.clip(needed, -ceiling, ceiling)) / per_step

    def _strain(self, index: int) -> None:
        """Torque of the shaft, and of the sensor behind its filter where something else follows it."""
        twist, shaft, line = self._twist, self._shaft, self._line
        np.subtract(self._ahead[0], self._ahead[1], out=twist)
        np.subtract(self.velocity[0], self.velocity[1], out=line)
        for own in self._bound["transmitted_twist"]:
            twist[own.lanes] = own.effect.transmitted_twist(twist[own.lanes])
            line[own.lanes] *= twist[own.lanes] != 0.0
        np.multiply(self._stiffness, twist, out=shaft)
        line *= self._shaft_damping
        shaft += line
        np.copyto(self._shafts[index], shaft)
        if self._torque_paths:
            self._torque_filter.pass_one(shaft, self._sensed)
        for own, path in self._torque_paths:
            self.torque_read[own.lanes] = path(self._sensed[own.lanes])

    def _raise_friction(self) -> None:
        level: Value = None
        group: slice | None = None
        for own in self._bound["coulomb"]:
            if own.lanes != group:  # a second effect of one group goes on from the first one's level
                group, level = own.lanes, own.of(self._level)
            level = own.effect.coulomb(level, own.now)
            own.of(self._level_now)[:] = level
            own.of(self._loss)[:] = level * own.of(self._brake)

    def _sense_velocity(self, mean: Array) -> None:
        """The encoder's difference over a sub-step, behind the drive's first-order filter where something follows."""
        for own, before in self._encoder_errors:
            error = own.effect.encoder_error(own.of(self._ahead))
            own.of(mean)[:] += (error - before) / STEP
            before[:] = error
        if self._velocity_paths:
            self._velocity_filter.pass_one(mean, self._filtered)
        for own, path in self._velocity_paths:
            own.of(self.velocity_read)[:] = path(own.of(self._filtered))

    # ---------------------------------------------------------------- readings

    def _measure(self, start: Array, before: Array) -> None:
        late = [(own, own.of(self.velocity_read).copy()) for own, _ in self._velocity_paths]
        np.copyto(self.velocity_read, self._filtered)
        for own, reading in late:
            own.of(self.velocity_read)[:] = reading
        kept = [(own, self.torque_read[own.lanes].copy()) for own, _ in self._torque_paths]
        np.copyto(self.torque_read, self._sensed)
        for own, reading in kept:
            self.torque_read[own.lanes] = reading
        for own in self._bound["sense_torque"]:
            self.torque_read[own.lanes] = own.effect.sense_torque(self.torque_read[own.lanes])
        voltage = self._resistance * self.current_mean + self._emf * (self.angle - before) / TICK
        voltage += self._inductance * (self.current - start) / TICK
        for own in self._bound["lost_voltage"]:
            lost, at = own.effect.lost_voltage, own.of
            own.of(voltage)[:] += (lost(at(start)) + 4.0 * lost(at(self.current_mean)) + lost(at(self.current))) / 6.0
        self.voltage_mean[:] = voltage
        for own in self._bound["bus_voltage"]:
            power = own.of(voltage) * own.of(self.current_mean)
            self.bus_voltage[own.lanes] = own.effect.bus_voltage(self._source[own.lanes], power)

    def _warm(self, speed: Array) -> None:
        heat = self._resistance[0] * self.current_mean[0] ** 2
        friction = self._line
        if self.thermal.needs_friction:
            friction = self._viscous[0] * speed**2 + self._level[0] * np.abs(speed)
        self.thermal.step(self.time, TICK, heat, speed, friction)

    @property
    def angle_read(self) -> Array:
        """Angles of the test actuators as their encoders have them, counts apart [rad]."""
        angle: Array = self.angle[0]
        if self._encoder_errors:
            angle = angle.copy()
            for own, _ in self._encoder_errors:
                angle[own.lanes] += own.effect.encoder_error(angle[own.lanes])
        return angle

    @property
    def current_sensed(self) -> Array:
        """Currents at the end of the millisecond as the drives' sensors have them [A]."""
        return self.current_gain * self.current + self.current_offset

    @property
    def current_mean_sensed(self) -> Array:
        """Currents over the millisecond as the drives' sensors have them [A]."""
        return self.current_gain * self.current_mean + self.current_offset

    @property
    def kinetic_and_strain_energy(self) -> Array:
        """Energy in rotors and shaft [J]."""
        kinetic = 0.5 * self._inertia * self.velocity**2
        total: Array = kinetic.sum(axis=0) + 0.5 * self._stiffness * (self.angle[0] - self.angle[1]) ** 2
        return total


class _Filter:
    """A first-order filter of a sensor in each lane, whose input is constant over a sub-step."""

    def __init__(self, bandwidth: Array) -> None:
        rate = 2.0 * math.pi * bandwidth * STEP
        self._gain, self._left = -np.expm1(-rate), np.exp(-rate * SUBSTEPS)
        self._weights = self._gain * np.exp(-rate * np.arange(SUBSTEPS - 1, -1, -1).reshape(-1, 1))

    def pass_one(self, value: Array, output: Array) -> None:
        """Take the output on by a sub-step."""
        output += self._gain * (value - output)

    def pass_all(self, values: Array, output: Array) -> None:
        """Take the output on by a millisecond.

        values : (sub-steps, ..., lanes).
        """
        output *= self._left
        output += np.einsum("kl,k...l->...l", self._weights, values)
