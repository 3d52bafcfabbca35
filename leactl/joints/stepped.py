"""Simulate joints by Euler's method: all runs are lanes of arrays, and each rotor sticks or slides."""

from collections.abc import Callable, Sequence

import numpy as np

from leactl.joints.programs import SERVO_CORNER_HZ, SERVO_HZ
from leactl.joints.run import STEPS_PER_SAMPLE, Array, JointRun, JointSignals

Column = Callable[[Callable[[JointRun], float]], Array]  # one number of every lane
Parameter = Callable[..., Array]  # effect, parameter and value without effect, for every lane
LEAST_BACK_EMF = 1e-9  # V; avoids a division by zero at rest, where no power limits a current
BURST_SHARE = 0.6  # of a sine's amplitude; above it a burst of friction acts


def simulate(runs: Sequence[JointRun]) -> list[JointSignals]:
    """Run every lane to the end of its references."""
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

        def nominal(name: str) -> Array:
            return column(lambda run: float(getattr(run.specimen.machine, name)))

        def true(name: str) -> Array:
            return column(lambda run: float(getattr(run.specimen, name)))

        self.step = 1.0 / nominal("rate") / STEPS_PER_SAMPLE
        self.constant, self.damping, self.coulomb = map(
            true, ("torque_constant", "viscous_damping", "coulomb_friction")
        )
        self._drive(runs, column, effect, nominal)
        self._torques(effect)
        self._frictions(effect)
        # a machine has one load, behind a spring or behind a gear's play
        share, inertia = effect("joint_elasticity", "share") + effect("gear_backlash", "share"), true("rotor_inertia")
        self.half_play, self.load_friction = 0.5 * effect("gear_backlash", "play"), effect("gear_backlash", "friction")
        self.has_gear = self.half_play > 0.0
        self.inertia, self.load = inertia * (1.0 - share), np.maximum(inertia * share, 1e-300)
        pulsation = 2.0 * np.pi * effect("joint_elasticity", "frequency")
        self.stiffness = inertia * share * pulsation**2
        self.spring_damping = 2.0 * effect("joint_elasticity", "damping_ratio") * inertia * share * pulsation
        self.eccentric, self.eccentric_phase = (effect("encoder_eccentricity", name) for name in ("amplitude", "phase"))
        lag = effect("velocity_filter_lag", "time_constant")
        self.filters = -np.expm1(-2.0 * np.pi * nominal("filter") * self.step)
        with np.errstate(divide="ignore"):
            self.lags = np.where(lag > 0.0, -np.expm1(-self.step / lag), 1.0)
        self.angle, zero = column(lambda run: run.angle), np.zeros(len(runs))
        self.speed, self.current, self.limited, self.before = (zero.copy() for _ in range(4))
        self.filtered, self.reading, self.integral, self.stretch = (zero.copy() for _ in range(4))
        self.twist, self.load_speed, self.charge, self.charge_before = (zero.copy() for _ in range(4))
        self.time, self.steps = zero.copy(), 0

    def _drive(
        self, runs: Sequence[JointRun], column: Column, effect: Parameter, nominal: Callable[[str], Array]
    ) -> None:
        self.servo = column(lambda run: float(run.program.velocity is not None))
        self.gain = 2.0 * np.pi * SERVO_HZ * nominal("rotor_inertia") / nominal("torque_constant")
        self.corner = 2.0 * np.pi * SERVO_CORNER_HZ / nominal("rate")
        self.peak_current = nominal("current")
        self.follows = -np.expm1(-2.0 * np.pi * nominal("loop") * self.step)
        self.offset = effect("current_sensor_offset", "offset")
        self.slew = effect("command_slew_limit", "rate", np.inf) * self.step
        self.bound = effect("torque_limit", "current", np.inf)
        self.power = effect("power_foldback", "power", np.inf)
        self.stall_current = effect("voltage_limit", "stall_current", np.inf)
        self.no_load_speed = effect("voltage_limit", "no_load_speed", np.inf)
        self.delay = np.rint(effect("transport_delay", "delay") / self.step).astype(int)
        self.queue = np.zeros((int(self.delay.max()) + 1, len(runs)))
        self.lane = np.arange(len(runs))
        self.holds = column(lambda run: float(run.log.holds))
        self.current_at = column(lambda run: float(STEPS_PER_SAMPLE - 1 - run.log.current_late))
        self.velocity_at = column(lambda run: float(STEPS_PER_SAMPLE - 1 - run.log.velocity_late))

    def _torques(self, effect: Parameter) -> None:
        self.loss = effect("saturation", "loss") / effect("saturation", "current", 1.0) ** 2
        self.ripple, self.ripple_order, self.ripple_phase = wave(effect, "torque_ripple")
        self.cogging, self.cogging_order, self.cogging_phase = wave(effect, "cogging")
        self.unbalance, self.unbalance_phase = (effect("unbalance", name) for name in ("amplitude", "phase"))
        self.drag = effect("quadratic_drag", "coefficient")
        self.push, self.push_phase = (effect("push_in_time", name) for name in ("amplitude", "phase"))
        self.push_rate = 2.0 * np.pi * effect("push_in_time", "frequency")
        self.weight, self.weight_phase = (effect("gravity_load", name) for name in ("amplitude", "phase"))
        self.cable, self.rest_angle = effect("position_spring", "stiffness"), effect("position_spring", "rest_angle")
        self.reach = effect("position_spring", "reach", 1.0)

    def _frictions(self, effect: Parameter) -> None:
        self.breakaway = effect("stribeck", "breakaway_ratio")
        self.stribeck_velocity = effect("stribeck", "stribeck_velocity", 1.0)
        self.asymmetry = effect("asymmetric_friction", "asymmetry")
        self.uneven, self.uneven_order, self.uneven_phase = wave(effect, "position_dependent_friction")
        self.excess, self.settling = (
            effect("friction_run_in", "excess"),
            effect("friction_run_in", "time_constant", 1.0),
        )
        self.burst, self.burst_phase = (effect("rubbing_bursts", name) for name in ("excess", "phase"))
        self.burst_rate = 2.0 * np.pi / effect("rubbing_bursts", "period", 1.0)
        self.displacement = effect("presliding", "displacement")
        self.has_no_presliding = self.displacement == 0.0

    def sample(self, current: Array, velocity: Array) -> tuple[Array, Array, Array, Array]:
        """Advance by one sample; returns reference, current, velocity and angle as the drive reads them."""
        reference = current + self.servo * self._servo(velocity)
        logged_current, logged_velocity = self.current, self.reading
        for part in range(STEPS_PER_SAMPLE):
            self._drive_step(
                self.before + (reference - self.before) * np.maximum(self.holds, (part + 1) / STEPS_PER_SAMPLE)
            )
            self._rotor_step()
            self.charge = self.charge + self.current + self.offset
            mean = (self.charge - self.charge_before) / STEPS_PER_SAMPLE
            due = self.current_at == part
            logged_current = np.where(due, mean, logged_current)
            self.charge_before = np.where(due, self.charge, self.charge_before)
            logged_velocity = np.where(self.velocity_at == part, self.reading, logged_velocity)
        self.before = reference
        encoder = self.angle + self.eccentric * np.sin(self.angle + self.eccentric_phase)
        return reference, logged_current, logged_velocity, encoder

    def _servo(self, velocity: Array) -> Array:
        error = velocity - self.reading
        unlimited = self.gain * (error + self.integral + self.corner * error)
        limited = np.clip(unlimited, -self.peak_current, self.peak_current)
        self.integral = self.integral + np.where(limited == unlimited, self.corner * error, 0.0)
        return limited

    def _drive_step(self, reference: Array) -> None:
        depth = len(self.queue)
        self.queue[self.steps % depth] = reference
        late = self.queue[(self.steps - self.delay) % depth, self.lane]
        fast = np.maximum(np.abs(self.speed) * self.constant, LEAST_BACK_EMF)
        late = np.clip(late, -np.minimum(self.bound, self.power / fast), np.minimum(self.bound, self.power / fast))
        back_emf_share = self.speed / self.no_load_speed
        late = np.clip(late, self.stall_current * (-1.0 - back_emf_share), self.stall_current * (1.0 - back_emf_share))
        self.limited = self.limited + np.clip(late - self.limited, -self.slew, self.slew)
        self.current = self.current + self.follows * (self.limited - self.current - self.offset)
        self.steps += 1

    def _rotor_step(self) -> None:
        angle, speed, step = self.angle, self.speed, self.step
        share = (1.0 - self.loss * self.current**2) * (
            1.0 + self.ripple * np.sin(self.ripple_order * angle + self.ripple_phase)
        )
        torque = self.constant * self.current * share - self.drag * speed * np.abs(speed)
        torque += self.cogging * np.sin(self.cogging_order * angle + self.cogging_phase)
        torque += self.unbalance * np.sin(angle + self.unbalance_phase)
        torque += self.push * np.sin(self.push_rate * self.time + self.push_phase)
        joint = angle - np.where(self.has_gear, self.twist, 0.0)
        load_torque = self.weight * np.cos(joint + self.weight_phase)
        load_torque += self.cable * self.reach * np.tanh((joint - self.rest_angle) / self.reach)
        torque -= np.where(self.has_gear, 0.0, load_torque)
        spring = self.stiffness * self.twist + self.spring_damping * (speed - self.load_speed)
        run_in = 1.0 + self.excess * np.exp(-self.time / self.settling)
        level = self.coulomb * run_in * self._uneven(angle, speed)
        self.stretch = np.clip(self.stretch + speed * step, -self.displacement, self.displacement)
        deflection = np.divide(self.stretch, self.displacement, out=np.zeros_like(step), where=~self.has_no_presliding)
        motor_share = 1.0 - self.load_friction
        push = torque - spring - motor_share * (self.damping * run_in * speed + level * deflection)
        sliding_friction = np.where(self.has_no_presliding, motor_share * level, 0.0)
        self.speed = reduced_by_friction(speed + push * step / self.inertia, sliding_friction * step / self.inertia)
        load_speed = np.where(self.stiffness > 0.0, self.load_speed + spring * step / self.load, self.speed)
        rotation, twist = self.speed * step, self.twist + (self.speed - load_speed) * step
        if self.has_gear.any():
            load_push = -load_torque - self.load_friction * self.damping * run_in * self.load_speed
            meshed = self._meshed(speed, (push, sliding_friction), (load_push, self.load_friction * level))
            pairs = zip(meshed, (self.speed, load_speed, twist, rotation), strict=True)
            self.speed, load_speed, twist, rotation = (
                np.where(self.has_gear, meshed_value, ungeared) for meshed_value, ungeared in pairs
            )
        self.load_speed, self.twist = load_speed, twist
        self.angle = angle + rotation
        self.time = self.time + step
        encoder_velocity = self.speed * (1.0 + self.eccentric * np.cos(self.angle + self.eccentric_phase))
        self.filtered = self.filtered + self.filters * (encoder_velocity - self.filtered)
        self.reading = self.reading + self.lags * (self.filtered - self.reading)

    def _meshed(self, before: Array, motor: tuple[Array, Array], load: tuple[Array, Array]) -> tuple[Array, ...]:
        """Step gears with play whose teeth meet without rebound.

        Returns the speeds of motors and loads, the angles between them and the rotations of the motors in this step.
        before : speed of the motors before this step. motor, load : torque on each and its Coulomb friction [N*m].
        """
        step, half = self.step, self.half_play
        load_inertia = np.where(self.has_gear, self.load, self.inertia)  # any number where no gear is
        total_inertia = self.inertia + load_inertia
        free_load_speed = reduced_by_friction(
            self.load_speed + load[0] * step / load_inertia, load[1] * step / load_inertia
        )
        relative_speed = self.speed - free_load_speed
        next_twist = self.twist + relative_speed * step
        pressed = (np.abs(self.twist) >= half) & (self.twist * relative_speed >= 0.0)
        meets = ~pressed & (np.abs(next_twist) >= half) & (next_twist * relative_speed > 0.0)
        momentum = self.inertia * before + load_inertia * self.load_speed + (motor[0] + load[0]) * step
        joined_speed = reduced_by_friction(momentum / total_inertia, (motor[1] + load[1]) * step / total_inertia)
        impact_speed = (self.inertia * self.speed + load_inertia * free_load_speed) / total_inertia
        meshed_speed = np.where(pressed, joined_speed, impact_speed)
        touches = pressed | meets  # when both meet within a step, their common centre of inertia keeps its speed
        speed, twist = (
            np.where(touches, meshed_speed, self.speed),
            np.where(meets, np.copysign(half, next_twist), next_twist),
        )
        rotation = speed * step + np.where(meets, load_inertia / total_inertia * (twist - self.twist), 0.0)
        return speed, np.where(touches, meshed_speed, free_load_speed), np.where(pressed, self.twist, twist), rotation

    def _uneven(self, angle: Array, speed: Array) -> Array:
        """Return the factor on Coulomb friction at an angle and a speed."""
        is_burst = np.sin(self.burst_rate * self.time + self.burst_phase) > BURST_SHARE
        factor = 1.0 + self.breakaway * np.exp(-np.abs(speed) / self.stribeck_velocity) + self.burst * is_burst
        factor *= 1.0 + self.asymmetry * np.sign(speed)
        return np.asarray(factor * (1.0 + self.uneven * np.cos(self.uneven_order * angle + self.uneven_phase)))


def reduced_by_friction(speed: Array, largest_change: Array) -> Array:
    """Reduce the magnitude of a speed by at most `largest_change`, not below zero."""
    return np.asarray(speed - np.clip(speed, -largest_change, largest_change), np.float64)


def wave(effect: Parameter, name: str) -> tuple[Array, Array, Array]:
    """Return amplitude, order and phase of a periodic effect, for every lane."""
    return effect(name, "amplitude"), effect(name, "order", 1.0), effect(name, "phase")
