"""The first simulator: all runs side by side as lanes of arrays, stepped by Euler with the rotor stuck or sliding."""

from collections.abc import Callable, Sequence

import numpy as np

from leactl.joints.programs import SERVO_CORNER_HZ, SERVO_HZ
from leactl.joints.run import PARTS, Array, JointRun, JointSignals

Column = Callable[[Callable[[JointRun], float]], Array]  # one number of every lane
Parameter = Callable[..., Array]  # effect, parameter and what does nothing, of every lane
TINY = 1e-9  # V, back-EMF below which no power folds a current back
BURST = 0.6  # of a sine, above which a burst rubs


def simulate(runs: Sequence[JointRun]) -> list[JointSignals]:
    """Run every lane to the end of its program."""
    lanes = JointLanes(runs)
    lengths = [len(run.asked(None)) for run in runs]
    longest = max(lengths)
    current, velocity = (padded(runs, quantity, longest) for quantity in ("current", "velocity"))
    kept = np.zeros((4, longest, len(runs)))
    for row in range(longest):
        kept[:, row] = lanes.sample(current[row], velocity[row])
    return [JointSignals(*(kept[k, :length, lane] for k in range(4))) for lane, length in enumerate(lengths)]


def padded(runs: Sequence[JointRun], quantity: str, longest: int) -> Array:
    """A reference of all runs, a row a sample; runs that have ended ask for nothing."""
    wanted = np.zeros((longest, len(runs)))
    for lane, run in enumerate(runs):
        asked = run.asked(getattr(run.program, quantity))
        wanted[: len(asked), lane] = asked
    return wanted


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

        self.step = 1.0 / nominal("rate") / PARTS
        self.constant, self.damping, self.coulomb = map(
            true, ("torque_constant", "viscous_damping", "coulomb_friction")
        )
        self._drive(runs, column, effect, nominal)
        self._torques(effect)
        self._frictions(effect)
        # a machine has one load, behind a spring or behind a gear's play
        share, inertia = effect("joint_elasticity", "share") + effect("gear_backlash", "share"), true("rotor_inertia")
        self.half_play, self.load_friction = 0.5 * effect("gear_backlash", "play"), effect("gear_backlash", "friction")
        self.geared = self.half_play > 0.0
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
        self.most = nominal("current")
        self.follows = -np.expm1(-2.0 * np.pi * nominal("loop") * self.step)
        self.offset = effect("current_sensor_offset", "offset")
        self.slew = effect("command_slew_limit", "rate", np.inf) * self.step
        self.bound = effect("torque_limit", "current", np.inf)
        self.power = effect("power_foldback", "power", np.inf)
        self.delay = np.rint(effect("transport_delay", "delay") / self.step).astype(int)
        self.queue = np.zeros((int(self.delay.max()) + 1, len(runs)))
        self.lane = np.arange(len(runs))
        self.holds = column(lambda run: float(run.log.holds))
        self.current_at = column(lambda run: float(PARTS - 1 - run.log.current_late))
        self.velocity_at = column(lambda run: float(PARTS - 1 - run.log.velocity_late))

    def _torques(self, effect: Parameter) -> None:
        self.loss = effect("saturation", "loss") / effect("saturation", "current", 1.0) ** 2
        self.ripple, self.ripple_order, self.ripple_phase = wave(effect, "torque_ripple")
        self.cogging, self.cogging_order, self.cogging_phase = wave(effect, "cogging")
        self.unbalance, self.unbalance_phase = (effect("unbalance", name) for name in ("amplitude", "phase"))
        self.drag = effect("quadratic_drag", "coefficient")
        self.push, self.push_phase = (effect("push_in_time", name) for name in ("amplitude", "phase"))
        self.push_rate = 2.0 * np.pi * effect("push_in_time", "frequency")
        self.weight, self.weight_phase = (effect("gravity_load", name) for name in ("amplitude", "phase"))
        self.cable, self.rest = effect("position_spring", "stiffness"), effect("position_spring", "rest_angle")
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
        self.slides = self.displacement == 0.0

    def sample(self, current: Array, velocity: Array) -> tuple[Array, Array, Array, Array]:
        """Advance by one sample; gives reference, current, velocity and angle as the drive has them."""
        reference = current + self.servo * self._servo(velocity)
        taken_current, taken_velocity = self.current, self.reading
        for part in range(PARTS):
            self._drive_step(self.before + (reference - self.before) * np.maximum(self.holds, (part + 1) / PARTS))
            self._rotor_step()
            self.charge = self.charge + self.current + self.offset
            mean = (self.charge - self.charge_before) / PARTS
            due = self.current_at == part
            taken_current = np.where(due, mean, taken_current)
            self.charge_before = np.where(due, self.charge, self.charge_before)
            taken_velocity = np.where(self.velocity_at == part, self.reading, taken_velocity)
        self.before = reference
        encoder = self.angle + self.eccentric * np.sin(self.angle + self.eccentric_phase)
        return reference, taken_current, taken_velocity, encoder

    def _servo(self, velocity: Array) -> Array:
        error = velocity - self.reading
        asked = self.gain * (error + self.integral + self.corner * error)
        given = np.clip(asked, -self.most, self.most)
        self.integral = self.integral + np.where(given == asked, self.corner * error, 0.0)
        return given

    def _drive_step(self, reference: Array) -> None:
        depth = len(self.queue)
        self.queue[self.steps % depth] = reference
        late = self.queue[(self.steps - self.delay) % depth, self.lane]
        fast = np.maximum(np.abs(self.speed) * self.constant, TINY)
        late = np.clip(late, -np.minimum(self.bound, self.power / fast), np.minimum(self.bound, self.power / fast))
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
        joint = angle - np.where(self.geared, self.twist, 0.0)
        outside = self.weight * np.cos(joint + self.weight_phase)
        outside += self.cable * self.reach * np.tanh((joint - self.rest) / self.reach)
        torque -= np.where(self.geared, 0.0, outside)
        spring = self.stiffness * self.twist + self.spring_damping * (speed - self.load_speed)
        more = 1.0 + self.excess * np.exp(-self.time / self.settling)
        level = self.coulomb * more * self._uneven(angle, speed)
        self.stretch = np.clip(self.stretch + speed * step, -self.displacement, self.displacement)
        gives = np.divide(self.stretch, self.displacement, out=np.zeros_like(step), where=~self.slides)
        kept = 1.0 - self.load_friction
        push = torque - spring - kept * (self.damping * more * speed + level * gives)
        rubs = np.where(self.slides, kept * level, 0.0)
        self.speed = slowed(speed + push * step / self.inertia, rubs * step / self.inertia)
        swung = np.where(self.stiffness > 0.0, self.load_speed + spring * step / self.load, self.speed)
        turned, twist = self.speed * step, self.twist + (self.speed - swung) * step
        if self.geared.any():
            hung = -outside - self.load_friction * self.damping * more * self.load_speed
            meshed = self._meshed(speed, (push, rubs), (hung, self.load_friction * level))
            geared = zip(meshed, (self.speed, swung, twist, turned), strict=True)
            self.speed, swung, twist, turned = (np.where(self.geared, mesh, rest) for mesh, rest in geared)
        self.load_speed, self.twist = swung, twist
        self.angle = angle + turned
        self.time = self.time + step
        seen = self.speed * (1.0 + self.eccentric * np.cos(self.angle + self.eccentric_phase))
        self.filtered = self.filtered + self.filters * (seen - self.filtered)
        self.reading = self.reading + self.lags * (self.filtered - self.reading)

    def _meshed(self, before: Array, motor: tuple[Array, Array], load: tuple[Array, Array]) -> tuple[Array, ...]:
        """Speeds of motors and loads, angles between and steps of motors, of teeth with play that meet without rebound.

        before : speed of the motors before this step. motor, load : torque on each and its Coulomb friction [N*m].
        """
        step, half = self.step, self.half_play
        hung = np.where(self.geared, self.load, self.inertia)  # any number where no gear is
        both = self.inertia + hung
        alone = slowed(self.load_speed + load[0] * step / hung, load[1] * step / hung)
        across = self.speed - alone
        ahead = self.twist + across * step
        pressed = (np.abs(self.twist) >= half) & (self.twist * across >= 0.0)
        meets = ~pressed & (np.abs(ahead) >= half) & (ahead * across > 0.0)
        momentum = self.inertia * before + hung * self.load_speed + (motor[0] + load[0]) * step
        as_one = slowed(momentum / both, (motor[1] + load[1]) * step / both)
        met = (self.inertia * self.speed + hung * alone) / both
        together = np.where(pressed, as_one, met)
        touches = pressed | meets  # the centre of inertia of the two stays its course where they meet within a step
        speed, twist = np.where(touches, together, self.speed), np.where(meets, np.copysign(half, ahead), ahead)
        turned = speed * step + np.where(meets, hung / both * (twist - self.twist), 0.0)
        return speed, np.where(touches, together, alone), np.where(pressed, self.twist, twist), turned

    def _uneven(self, angle: Array, speed: Array) -> Array:
        """Factor on Coulomb friction."""
        rubs = np.sin(self.burst_rate * self.time + self.burst_phase) > BURST
        factor = 1.0 + self.breakaway * np.exp(-np.abs(speed) / self.stribeck_velocity) + self.burst * rubs
        factor *= 1.0 + self.asymmetry * np.sign(speed)
        return np.asarray(factor * (1.0 + self.uneven * np.cos(self.uneven_order * angle + self.uneven_phase)))


def slowed(speed: Array, most: Array) -> Array:
    """Speed that friction takes up to so much of, down to standstill and no further."""
    return np.asarray(speed - np.clip(speed, -most, most), np.float64)


def wave(effect: Parameter, name: str) -> tuple[Array, Array, Array]:
    """Amplitude, order and phase of a periodic effect."""
    return effect(name, "amplitude"), effect(name, "order", 1.0), effect(name, "phase")
