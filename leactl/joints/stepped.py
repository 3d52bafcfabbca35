"""Simulate joints by Euler's method: all runs are lanes of arrays, and each rotor sticks or slides."""

from collections.abc import Callable, Sequence

import numpy as np

from leactl.joints.programs import SERVO_CORNER_HZ, SERVO_HZ
from leactl.joints.run import STEPS_PER_SAMPLE, Array, JointRun, JointSignals

Column = Callable[[Callable[[JointRun], float]], Array]  # returns one number of every lane
Parameter = Callable[..., Array]  # returns an effect's parameter, or a value without effect, for every lane
LEAST_BACK_EMF = 1e-9  # V; avoids a division by zero at rest, where no power limits a current
BURST_SHARE = 0.6  # share of a sine's amplitude above which a burst of friction acts


def simulate(runs: Sequence[JointRun]) -> list[JointSignals]:
    """Return the signals of all runs, each simulated to the end of its references."""
    lanes = JointLanes(runs)
    lengths = [len(run.reference_or_zeros(None)) for run in runs]
    longest = max(lengths)
    current, velocity = (padded(runs, quantity, longest) for quantity in ("current", "velocity"))
    signals = np.zeros((4, longest, len(runs)))
    for row in range(longest):
        signals[:, row] = lanes.sample(current[row], velocity[row])
    return [JointSignals(*(signals[k, :length, lane] for k in range(4))) for lane, length in enumerate(lengths)]


def padded(runs: Sequence[JointRun], quantity: str, longest: int) -> Array:
    """Return a reference of all runs, shape (samples, lanes); zero after the end of a run."""
    references = np.zeros((longest, len(runs)))
    for lane, run in enumerate(runs):
        reference = run.reference_or_zeros(getattr(run.program, quantity))
        references[: len(reference), lane] = reference
    return references


class JointLanes:
    """Drives, rotors and filters of all runs."""

    def __init__(self, runs: Sequence[JointRun]) -> None:
        def column(number: Callable[[JointRun], float]) -> Array:
            return np.array([number(run) for run in runs], np.float64)

        def effect(name: str, parameter: str, otherwise: float = 0.0) -> Array:
            return column(lambda run: run.parameter(name, parameter, otherwise))

        def of_machine(name: str) -> Array:
            return column(lambda run: float(getattr(run.specimen.machine, name)))

        def of_specimen(name: str) -> Array:
            return column(lambda run: float(getattr(run.specimen, name)))

        self.step = 1.0 / of_machine("rate") / STEPS_PER_SAMPLE
        self.torque_constant, self.damping, self.coulomb = map(
            of_specimen, ("torque_constant", "viscous_damping", "coulomb_friction")
        )
        self._drive(runs, column, effect, of_machine)
        self._torques(effect)
        self._frictions(effect)
        # a machine has one load, behind a spring or behind a gear's play
        share, inertia = (
            effect("joint_elasticity", "share") + effect("gear_backlash", "share"),
            of_specimen("rotor_inertia"),
        )
        self.half_play, self.load_friction = 0.5 * effect("gear_backlash", "play"), effect("gear_backlash", "friction")
        self.has_gear = self.half_play > 0.0
        self.inertia, self.load_inertia = inertia * (1.0 - share), np.maximum(inertia * share, 1e-300)
        angular_frequency = 2.0 * np.pi * effect("joint_elasticity", "frequency")
        self.stiffness = inertia * share * angular_frequency**2
        self.spring_damping = 2.0 * effect("joint_elasticity", "damping_ratio") * inertia * share * angular_frequency
        self.eccentricity, self.eccentricity_phase = (
            effect("encoder_eccentricity", name) for name in ("amplitude", "phase")
        )
        lag_time = effect("velocity_filter_lag", "time_constant")
        self.filter_gain = -np.expm1(-2.0 * np.pi * of_machine("filter") * self.step)
        with np.errstate(divide="ignore"):
            self.lag_gain = np.where(lag_time > 0.0, -np.expm1(-self.step / lag_time), 1.0)
        self.angle, zero = column(lambda run: run.angle), np.zeros(len(runs))
        self.speed, self.current, self.slewed_command, self.previous_reference = (zero.copy() for _ in range(4))
        self.filtered, self.reading, self.integral, self.bristle = (zero.copy() for _ in range(4))
        self.twist, self.load_speed, self.current_sum, self.current_sum_before = (zero.copy() for _ in range(4))
        self.time, self.step_count = zero.copy(), 0

    def _drive(
        self, runs: Sequence[JointRun], column: Column, effect: Parameter, of_machine: Callable[[str], Array]
    ) -> None:
        """Set the parameters of drives, their limits and their logs."""
        self.servo = column(lambda run: float(run.program.velocity is not None))
        self.proportional_gain = 2.0 * np.pi * SERVO_HZ * of_machine("rotor_inertia") / of_machine("torque_constant")
        self.integral_gain = 2.0 * np.pi * SERVO_CORNER_HZ / of_machine("rate")
        self.peak_current = of_machine("current")
        self.loop_gain = -np.expm1(-2.0 * np.pi * of_machine("loop") * self.step)
        self.offset = effect("current_sensor_offset", "offset")
        self.largest_change = effect("command_slew_limit", "rate", np.inf) * self.step
        self.current_limit = effect("torque_limit", "current", np.inf)
        self.power_limit = effect("power_foldback", "power", np.inf)
        self.stall_current = effect("voltage_limit", "stall_current", np.inf)
        self.no_load_speed = effect("voltage_limit", "no_load_speed", np.inf)
        self.delay = np.rint(effect("transport_delay", "delay") / self.step).astype(int)
        self.queue = np.zeros((int(self.delay.max()) + 1, len(runs)))
        self.lane = np.arange(len(runs))
        self.holds = column(lambda run: float(run.log.holds))
        self.current_at = column(lambda run: float(STEPS_PER_SAMPLE - 1 - run.log.current_late))
        self.velocity_at = column(lambda run: float(STEPS_PER_SAMPLE - 1 - run.log.velocity_late))

    def _torques(self, effect: Parameter) -> None:
        """Set the parameters of effects that change the torque on the rotor."""
        self.loss = effect("saturation", "loss") / effect("saturation", "current", 1.0) ** 2
        self.ripple, self.ripple_order, self.ripple_phase = wave_parameters(effect, "torque_ripple")
        self.cogging, self.cogging_order, self.cogging_phase = wave_parameters(effect, "cogging")
        self.unbalance, self.unbalance_phase = (effect("unbalance", name) for name in ("amplitude", "phase"))
        self.drag = effect("quadratic_drag", "coefficient")
        self.push, self.push_phase = (effect("push_in_time", name) for name in ("amplitude", "phase"))
        self.push_rate = 2.0 * np.pi * effect("push_in_time", "frequency")
        self.weight, self.weight_phase = (effect("gravity_load", name) for name in ("amplitude", "phase"))
        self.position_stiffness, self.rest_angle = (
            effect("position_spring", "stiffness"),
            effect("position_spring", "rest_angle"),
        )
        self.position_reach = effect("position_spring", "reach", 1.0)

    def _frictions(self, effect: Parameter) -> None:
        """Set the parameters of effects that change the friction."""
        self.breakaway = effect("stribeck", "breakaway_ratio")
        self.stribeck_velocity = effect("stribeck", "stribeck_velocity", 1.0)
        self.asymmetry = effect("asymmetric_friction", "asymmetry")
        self.friction_ripple, self.friction_ripple_order, self.friction_ripple_phase = wave_parameters(
            effect, "position_dependent_friction"
        )
        self.run_in_excess, self.run_in_time = (
            effect("friction_run_in", "excess"),
            effect("friction_run_in", "time_constant", 1.0),
        )
        self.burst, self.burst_phase = (effect("rubbing_bursts", name) for name in ("excess", "phase"))
        self.burst_rate = 2.0 * np.pi / effect("rubbing_bursts", "period", 1.0)
        self.displacement = effect("presliding", "displacement")
        self.has_no_presliding = self.displacement == 0.0

    def sample(self, current: Array, velocity: Array) -> tuple[Array, Array, Array, Array]:
        """Advance by one sample; return reference, current, velocity and angle as the drive logs them."""
        reference = current + self.servo * self._servo(velocity)
        logged_current, logged_velocity = self.current, self.reading
        for substep in range(STEPS_PER_SAMPLE):
            self._drive_step(
                self.previous_reference
                + (reference - self.previous_reference) * np.maximum(self.holds, (substep + 1) / STEPS_PER_SAMPLE)
            )
            self._rotor_step()
            self.current_sum = self.current_sum + self.current + self.offset
            mean = (self.current_sum - self.current_sum_before) / STEPS_PER_SAMPLE
            is_due = self.current_at == substep
            logged_current = np.where(is_due, mean, logged_current)
            self.current_sum_before = np.where(is_due, self.current_sum, self.current_sum_before)
            logged_velocity = np.where(self.velocity_at == substep, self.reading, logged_velocity)
        self.previous_reference = reference
        encoder = self.angle + self.eccentricity * np.sin(self.angle + self.eccentricity_phase)
        return reference, logged_current, logged_velocity, encoder

    def _servo(self, velocity: Array) -> Array:
        """Return the current references [A] of the velocity servos."""
        error = velocity - self.reading
        unlimited = self.proportional_gain * (error + self.integral + self.integral_gain * error)
        limited = np.clip(unlimited, -self.peak_current, self.peak_current)
        self.integral = self.integral + np.where(limited == unlimited, self.integral_gain * error, 0.0)
        return limited

    def _drive_step(self, reference: Array) -> None:
        """Step the delay, the limits and the current loop of every drive."""
        queue_length = len(self.queue)
        self.queue[self.step_count % queue_length] = reference
        command = self.queue[(self.step_count - self.delay) % queue_length, self.lane]
        back_emf = np.maximum(np.abs(self.speed) * self.torque_constant, LEAST_BACK_EMF)
        command = np.clip(
            command,
            -np.minimum(self.current_limit, self.power_limit / back_emf),
            np.minimum(self.current_limit, self.power_limit / back_emf),
        )
        back_emf_share = self.speed / self.no_load_speed
        command = np.clip(
            command, self.stall_current * (-1.0 - back_emf_share), self.stall_current * (1.0 - back_emf_share)
        )
        self.slewed_command = self.slewed_command + np.clip(
            command - self.slewed_command, -self.largest_change, self.largest_change
        )
        self.current = self.current + self.loop_gain * (self.slewed_command - self.current - self.offset)
        self.step_count += 1

    def _rotor_step(self) -> None:
        """Step the rotor, the load and the velocity filters of every lane."""
        angle, speed, step = self.angle, self.speed, self.step
        torque_factor = (1.0 - self.loss * self.current**2) * (
            1.0 + self.ripple * np.sin(self.ripple_order * angle + self.ripple_phase)
        )
        torque = self.torque_constant * self.current * torque_factor - self.drag * speed * np.abs(speed)
        torque += self.cogging * np.sin(self.cogging_order * angle + self.cogging_phase)
        torque += self.unbalance * np.sin(angle + self.unbalance_phase)
        torque += self.push * np.sin(self.push_rate * self.time + self.push_phase)
        joint_angle = angle - np.where(self.has_gear, self.twist, 0.0)
        load_torque = self.weight * np.cos(joint_angle + self.weight_phase)
        load_torque += (
            self.position_stiffness
            * self.position_reach
            * np.tanh((joint_angle - self.rest_angle) / self.position_reach)
        )
        torque -= np.where(self.has_gear, 0.0, load_torque)
        spring_torque = self.stiffness * self.twist + self.spring_damping * (speed - self.load_speed)
        run_in_factor = 1.0 + self.run_in_excess * np.exp(-self.time / self.run_in_time)
        friction_level = self.coulomb * run_in_factor * self._friction_factor(angle, speed)
        self.bristle = np.clip(self.bristle + speed * step, -self.displacement, self.displacement)
        deflection = np.divide(self.bristle, self.displacement, out=np.zeros_like(step), where=~self.has_no_presliding)
        motor_share = 1.0 - self.load_friction
        net_torque = (
            torque - spring_torque - motor_share * (self.damping * run_in_factor * speed + friction_level * deflection)
        )
        sliding_friction = np.where(self.has_no_presliding, motor_share * friction_level, 0.0)
        self.speed = reduced_by_friction(
            speed + net_torque * step / self.inertia, sliding_friction * step / self.inertia
        )
        load_speed = np.where(
            self.stiffness > 0.0, self.load_speed + spring_torque * step / self.load_inertia, self.speed
        )
        rotation, twist = self.speed * step, self.twist + (self.speed - load_speed) * step
        if self.has_gear.any():
            load_net_torque = -load_torque - self.load_friction * self.damping * run_in_factor * self.load_speed
            meshed = self._meshed(
                speed, (net_torque, sliding_friction), (load_net_torque, self.load_friction * friction_level)
            )
            pairs = zip(meshed, (self.speed, load_speed, twist, rotation), strict=True)
            self.speed, load_speed, twist, rotation = (
                np.where(self.has_gear, meshed_value, ungeared) for meshed_value, ungeared in pairs
            )
        self.load_speed, self.twist = load_speed, twist
        self.angle = angle + rotation
        self.time = self.time + step
        encoder_velocity = self.speed * (1.0 + self.eccentricity * np.cos(self.angle + self.eccentricity_phase))
        self.filtered = self.filtered + self.filter_gain * (encoder_velocity - self.filtered)
        self.reading = self.reading + self.lag_gain * (self.filtered - self.reading)

    def _meshed(
        self, motor_speed_before: Array, motor: tuple[Array, Array], load: tuple[Array, Array]
    ) -> tuple[Array, ...]:
        """Step gears with play whose teeth meet without rebound.

        Return the speeds of motors and loads [rad/s], the angles between them [rad], and the rotations of the motors in
        this step [rad].

        motor_speed_before : rad/s, speed of the motors before this step.
        motor, load : torque on motors or loads, and their Coulomb friction [N*m].
        """
        step, half_play = self.step, self.half_play
        (motor_torque, motor_friction), (load_torque, load_friction) = motor, load
        # any number but zero in lanes without a gear
        load_inertia = np.where(self.has_gear, self.load_inertia, self.inertia)
        total_inertia = self.inertia + load_inertia
        free_load_speed = reduced_by_friction(
            self.load_speed + load_torque * step / load_inertia, load_friction * step / load_inertia
        )
        relative_speed = self.speed - free_load_speed
        next_twist = self.twist + relative_speed * step
        is_pressed = (np.abs(self.twist) >= half_play) & (self.twist * relative_speed >= 0.0)
        is_meeting = ~is_pressed & (np.abs(next_twist) >= half_play) & (next_twist * relative_speed > 0.0)
        momentum = (
            self.inertia * motor_speed_before + load_inertia * self.load_speed + (motor_torque + load_torque) * step
        )
        joined_speed = reduced_by_friction(
            momentum / total_inertia, (motor_friction + load_friction) * step / total_inertia
        )
        impact_speed = (self.inertia * self.speed + load_inertia * free_load_speed) / total_inertia
        meshed_speed = np.where(is_pressed, joined_speed, impact_speed)
        # if teeth meet within a step, the common centre of inertia keeps its speed
        is_touching = is_pressed | is_meeting
        speed, twist = (
            np.where(is_touching, meshed_speed, self.speed),
            np.where(is_meeting, np.copysign(half_play, next_twist), next_twist),
        )
        rotation = speed * step + np.where(is_meeting, load_inertia / total_inertia * (twist - self.twist), 0.0)
        return (
            speed,
            np.where(is_touching, meshed_speed, free_load_speed),
            np.where(is_pressed, self.twist, twist),
            rotation,
        )

    def _friction_factor(self, angle: Array, speed: Array) -> Array:
        """Return the factor on Coulomb friction at an angle and a speed."""
        is_burst = np.sin(self.burst_rate * self.time + self.burst_phase) > BURST_SHARE
        factor = 1.0 + self.breakaway * np.exp(-np.abs(speed) / self.stribeck_velocity) + self.burst * is_burst
        factor *= 1.0 + self.asymmetry * np.sign(speed)
        return np.asarray(
            factor
            * (1.0 + self.friction_ripple * np.cos(self.friction_ripple_order * angle + self.friction_ripple_phase))
        )


def reduced_by_friction(speed: Array, largest_change: Array) -> Array:
    """Return a speed whose magnitude is reduced by at most `largest_change`, not below zero."""
    return np.asarray(speed - np.clip(speed, -largest_change, largest_change), np.float64)


def wave_parameters(effect: Parameter, name: str) -> tuple[Array, Array, Array]:
    """Return amplitude, order and phase of a periodic effect, for every lane."""
    return effect(name, "amplitude"), effect(name, "order", 1.0), effect(name, "phase")
