"""Rotors on a shaft, many stretches of many runs stepped side by side.

The shaft is a spring between two rotors (leap-frog: velocities between the instants, angles and torques at them). A
free rotor has no spring, a locked one an end that does not move. At standstill friction opposes up to its Coulomb
level: the test rotor's as bristles that bend a little before they slide (Dahl, 1968), as those of any bearing do, the
load's by cancelling its velocity, down to standstill and no further.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.effects.plant import Moment, Plant

Array = npt.NDArray[np.float64]
BRISTLE_DAMPING = 0.2  # of critical, while bristles bend slowly: without it a sticking rotor would ring for ever
SHAFT_DAMPING = 0.03  # of critical, as steel shafts with clamped couplings have
MOST_HALF_PHASE = 1.0  # rad, largest half phase of a shaft's resonance in a step; a stiffer shaft is practically rigid


@dataclass
class LaneState:
    """State of each lane."""

    angle: Array  # rad, of the test rotor
    velocity: Array  # rad/s, of the test rotor, half a step earlier
    load_velocity: Array  # rad/s, half a step earlier
    twist: Array  # rad, of the shaft
    bristle: Array  # -1 .. 1, friction that has built up

    def of_lanes(self, lanes: npt.NDArray[np.intp]) -> "LaneState":
        """Return the state of some lanes."""
        return LaneState(*(values[lanes] for values in vars(self).values()))


@dataclass
class Servo:
    """Voltage from the angle error, and the current that it drives against the back-EMF."""

    reference: Array  # rad, (steps, lanes); NaN while the drive is disabled and no current flows
    gain: Array  # V/rad
    damping: Array  # V*s/rad, on the rate of the error
    limit: Array  # V
    resistance: Array  # ohm
    torque_constant: Array  # N*m/A
    emf: Array  # V*s/rad
    held: int  # number of steps for which a reference is constant


@dataclass
class Tracking:
    """A torque that keeps a rotor near a motion: a spring and a damper between the two."""

    angle: Array  # rad, (steps, lanes)
    velocity: Array  # rad/s, (steps, lanes)
    stiffness: Array  # N*m/rad
    damping: Array  # N*m*s/rad


@dataclass
class Lanes:
    """Stretches of runs with the constants of their benches: one value for each lane, inputs also for each step."""

    step: float  # s
    plants: Sequence[tuple[Plant, slice]]  # lanes of one bench are adjacent
    drive: Array  # N*m, (steps, lanes)
    load_drive: Array | None  # N*m, (steps, lanes)
    friction_share: Array | None  # factor, (steps, lanes)
    inertia: Array  # kg*m^2
    damping: Array  # N*m*s/rad
    emf_damping: Array  # N*m*s/rad, of the back-EMF under a voltage that is given
    friction: Array  # N*m
    load_inertia: Array  # kg*m^2; infinite where the shaft's end is held
    load_damping: Array  # N*m*s/rad
    load_friction: Array  # N*m
    stiffness: Array  # N*m/rad; zero where nothing is on the shaft
    damping_ratio: Array  # of critical, of the shaft
    gravity: Array  # N*m, torque of a level pendulum or arm on the test rotor
    load_gravity: Array  # N*m, of one on the coupled part of a free rotor
    hanging: Array  # rad, angle of a pendulum or arm that hangs straight down
    servo: Servo | None = None
    tracking: Tracking | None = None


@dataclass
class LaneMotion:
    """Motion of the lanes; arrays have shape (steps, lanes)."""

    angle: Array  # rad, at the beginning of each step
    velocity: Array  # rad/s, over each step
    torque: Array  # N*m, onto the shaft, at the beginning of each step
    load_velocity: Array  # rad/s, over each step
    current: Array | None  # A, of a servo
    pull: Array | None  # N*m, torque that tracking adds to the drive
    end: LaneState


def resonant_stiffness(lanes: Lanes) -> Array:
    """Return the stiffness [N*m/rad] with which the discrete steps ring at the shaft's natural frequency."""
    mobility = 1.0 / lanes.inertia + 1.0 / lanes.load_inertia
    half_phase = 0.5 * lanes.step * np.sqrt(lanes.stiffness * mobility)
    return np.asarray(
        np.sin(np.minimum(half_phase, MOST_HALF_PHASE)) ** 2 * 4.0 / (lanes.step**2 * mobility), np.float64
    )


def step_lanes(lanes: Lanes, start: LaneState) -> LaneMotion:
    """Return the motion of every lane, stepped from its start to its end."""
    steps, count = lanes.drive.shape
    h = lanes.step
    servo = lanes.servo
    # taken at a step's start, half a step late, back-EMF would reduce the inertia and make a light axis oscillate
    braking = servo.torque_constant * servo.emf / servo.resistance if servo is not None else np.zeros(count)
    decay, gain = _velocity_response(lanes.damping + lanes.emf_damping + braking, lanes.inertia, h)
    # where a servo is off, no current brakes
    unbraked_decay, unbraked_gain = _velocity_response(lanes.damping + lanes.emf_damping, lanes.inertia, h)
    load_decay, load_gain = _velocity_response(lanes.load_damping, lanes.load_inertia, h)
    stiffness = resonant_stiffness(lanes)
    shaft_damping = 2.0 * lanes.damping_ratio * np.sqrt(stiffness / (1.0 / lanes.inertia + 1.0 / lanes.load_inertia))
    bristles = _Bristles(lanes, gain)
    has_shaft = bool(np.any(stiffness > 0))
    # at the end of a shaft between two actuators, the torque on the shaft counts alone
    gravity = np.where(stiffness > 0.0, 0.0, lanes.gravity)
    has_gravity, has_load_gravity = bool(np.any(gravity != 0)), bool(np.any(lanes.load_gravity != 0))
    hangs = has_load_gravity or bool(np.any(lanes.gravity != 0))
    load_turns, voltage_fed = has_shaft and bool(np.any(load_gain > 0)), bool(np.any(lanes.emf_damping > 0))
    friction_step, load_friction_step = gain * lanes.friction, load_gain * lanes.load_friction
    groups = [_Group(plant, lanes_of_plant, gain) for plant, lanes_of_plant in lanes.plants]
    groups = [group for group in groups if group.acts]
    angle, velocity = start.angle.copy(), start.velocity.copy()
    load_velocity, twist, bristle = start.load_velocity.copy(), start.twist.copy(), start.bristle.copy()
    frictionless_velocity, push, torque = np.empty(count), np.empty(count), np.zeros(count)
    shape = (steps, count)
    current = np.empty(shape) if servo is not None else None
    pull = np.empty(shape) if lanes.tracking is not None else None
    motion = LaneMotion(np.empty(shape), np.empty(shape), np.zeros(shape), np.zeros(shape), current, pull, start)
    for group in groups:
        group.attach(angle, velocity, frictionless_velocity, torque, twist, push)
    for index in range(steps):
        drive = lanes.drive[index]
        if motion.pull is not None:
            motion.pull[index] = _tracking_torque(lanes.tracking, index, angle, velocity)
            drive = drive + motion.pull[index]
        if servo is not None and motion.current is not None:
            servo_current = motion.current[index] = _servo_current(servo, lanes.step, index, angle, velocity, groups)
            drive = servo.torque_constant * servo_current
            for group in groups:
                group.scale_servo_torque(drive, servo_current)
        if has_shaft:
            np.multiply(stiffness, twist, out=torque)
            torque += shaft_damping * (velocity - load_velocity)
            for group in groups:
                group.remove_torque_in_play(stiffness)
        if has_gravity:
            weight = gravity * np.sin(angle - lanes.hanging)
            torque[:] = torque + weight if has_shaft else weight
        np.subtract(drive, torque, out=push)
        decay_now, gain_now, friction_step_now = decay, gain, friction_step
        if servo is not None:
            is_disabled = np.isnan(servo.reference[index])
            push += np.where(is_disabled, 0.0, braking * velocity)  # current and decay both contain the back-EMF
            if is_disabled.any():
                decay_now, gain_now = (
                    np.where(is_disabled, unbraked_decay, decay),
                    np.where(is_disabled, unbraked_gain, gain),
                )
                friction_step_now = gain_now * lanes.friction
        motion.torque[index] = torque
        motion.angle[index] = angle
        level = friction_step_now
        if groups:
            if lanes.friction_share is not None:
                share = lanes.friction_share[index]
                level = friction_step_now * share
                push -= (share - 1.0) * lanes.damping * velocity
            elif any(group.rubs for group in groups):
                level = friction_step_now.copy()
            drive_torque = drive - lanes.emf_damping * velocity if voltage_fed else drive
            for group in groups:
                group.drive(drive_torque, drive_torque if hangs else torque)
        np.multiply(velocity, decay_now, out=frictionless_velocity)
        push *= gain_now
        frictionless_velocity += push
        for group in groups:
            group.scale_friction(level)
        bristles.step(level, frictionless_velocity, bristle, velocity)
        motion.velocity[index] = velocity
        angle += h * velocity
        if has_shaft:
            twist += h * velocity
            if load_turns:
                assert lanes.load_drive is not None
                load_push = lanes.load_drive[index] + torque
                if has_load_gravity:
                    load_push = load_push - lanes.load_gravity * np.sin(angle - twist - lanes.hanging)
                frictionless_load_velocity = load_decay * load_velocity + load_gain * load_push
                load_velocity = frictionless_load_velocity - np.minimum(
                    np.maximum(frictionless_load_velocity, -load_friction_step), load_friction_step
                )
                twist -= h * load_velocity
                motion.load_velocity[index] = load_velocity
    motion.end = LaneState(angle, velocity, load_velocity, twist, bristle)
    if has_shaft:
        correct_softness(motion, lanes, stiffness)
    return motion


def correct_softness(motion: LaneMotion, lanes: Lanes, stiffness: Array) -> None:
    """Correct the motion for the softer spring of the discrete steps, which twists too much.

    The excess twist is removed where no balance of torques reads it: the load's speed is raised, or a locked rotor's
    angle and speed are lowered.
    """
    excess_compliance, has_shaft = np.zeros_like(stiffness), lanes.stiffness > 0.0
    excess_compliance[has_shaft] = 1.0 / stiffness[has_shaft] - 1.0 / lanes.stiffness[has_shaft]
    excess_twist = excess_compliance * motion.torque
    excess_speed = np.diff(excess_twist, axis=0, append=excess_twist[-1:]) / lanes.step
    locked = np.isinf(lanes.load_inertia)
    motion.angle -= np.where(locked, excess_twist, 0.0)
    motion.velocity -= np.where(locked, excess_speed, 0.0)
    motion.load_velocity += np.where(locked, 0.0, excess_speed)


def _servo_current(
    servo: Servo, step: float, index: int, angle: Array, velocity: Array, groups: "list[_Group]"
) -> Array:
    """Return the current [A] of the servo's voltage in the winding, zero while it is disabled."""
    reference = servo.reference[index]
    error = reference - angle
    for group in groups:
        group.transform_error(error)
    volts = servo.gain * error
    if np.any(servo.damping):
        volts += servo.damping * (_reference_rate(servo, step, index) - velocity)
    volts = np.clip(volts, -servo.limit, servo.limit)
    current = (volts - servo.emf * velocity) / servo.resistance
    for group in groups:
        group.subtract_lost_voltage(volts, current)
        current = (volts - servo.emf * velocity) / servo.resistance
    return np.where(np.isnan(reference), 0.0, current)


def _reference_rate(servo: Servo, step: float, index: int) -> Array:
    """Return the rate [rad/s] of the servo's reference over one holding interval; zero at the beginning."""
    earlier = servo.reference[max(index - servo.held, 0)]
    speed = (servo.reference[index] - earlier) / (servo.held * step)
    return np.asarray(np.nan_to_num(speed), np.float64)


def _tracking_torque(tracking: Tracking | None, index: int, angle: Array, velocity: Array) -> Array:
    """Return the torque [N*m] of the spring and damper to the tracked motion."""
    assert tracking is not None
    pull = tracking.stiffness * (tracking.angle[index] - angle)
    return np.asarray(pull + tracking.damping * (tracking.velocity[index] - velocity), np.float64)


def _velocity_response(damping: Array, inertia: Array, step: float) -> tuple[Array, Array]:
    """Return the decay of a velocity over a step and its gain [rad/s per N*m], exact for a damped inertia."""
    rate = damping / inertia * step
    gain = np.where(rate > 1e-9, -np.expm1(-rate) / np.where(rate > 1e-9, rate, 1.0), 1.0) * step / inertia
    return np.where(np.isinf(inertia), 0.0, np.exp(-rate)), np.asarray(gain, np.float64)


class _Bristles:
    """Friction of the test rotors as bristles that bend and then slide (Dahl)."""

    def __init__(self, lanes: Lanes, gain: Array) -> None:
        reach, is_presliding = np.empty(len(gain)), np.zeros(len(gain), bool)
        for plant, lanes_of_plant in lanes.plants:
            reach[lanes_of_plant] = plant.bristle or plant.give
            is_presliding[lanes_of_plant] = plant.bristle > 0.0
        # bristles stiffer than a step resolves would drive the rotor back and forth
        reach = np.maximum(reach, 0.5 * lanes.step * gain * lanes.friction)
        self.bend_per_speed = lanes.step / reach
        self.damping = 2.0 * BRISTLE_DAMPING * gain * np.sqrt(lanes.friction / reach * lanes.inertia)
        # s/rad, inverse of the speed that bent bristles give a rotor. Above it the damping of presliding fades: in a
        # swift reversal it would take the place of the friction that has not built up.
        self.fading = np.zeros(len(gain))
        np.divide(lanes.inertia, lanes.friction * reach, out=self.fading, where=is_presliding & (lanes.friction > 0.0))
        np.sqrt(self.fading, out=self.fading)
        self._faded = np.empty(len(gain))

    def step(self, level: Array, frictionless_velocity: Array, bristle: Array, velocity: Array) -> None:
        """Compute the velocity under friction from the frictionless one, and bend the bristles; all arrays in place.

        level : change of the velocity [rad/s] over the step by sliding friction.
        frictionless_velocity : rad/s, is overwritten.
        bristle : share of the friction that has built up; it is updated.
        velocity : rad/s, the result.
        """
        np.abs(bristle, out=velocity)
        np.subtract(1.0, velocity, out=velocity)
        velocity *= self.damping
        np.multiply(frictionless_velocity, self.fading, out=self._faded)
        self._faded *= self._faded
        self._faded += 1.0
        velocity /= self._faded
        velocity += 1.0
        frictionless_velocity -= level * bristle
        np.divide(frictionless_velocity, velocity, out=velocity)
        bend = self.bend_per_speed * velocity
        bristle += bend
        bristle /= 1.0 + np.abs(bend)


class _Group:
    """Effects of one bench on its lanes."""

    def __init__(self, plant: Plant, lanes: slice, gain: Array) -> None:
        self.plant, self.lanes, self.gain = plant, lanes, gain[lanes]
        self.pushes = bool(plant.ripple or plant.rotor_torque or plant.drag)
        self.rubs = bool(plant.coulomb_share or plant.coulomb_added)
        electric_effects = plant.lost_voltage or plant.torque_share or plant.servo_error
        self.acts = self.pushes or self.rubs or bool(plant.play or electric_effects or plant.friction_share)

    def attach(
        self, angle: Array, velocity: Array, frictionless_velocity: Array, torque: Array, twist: Array, push: Array
    ) -> None:
        """Keep views of this bench's lanes in the shared arrays, which the stepper updates in place."""
        lanes = self.lanes
        self.torque, self.twist, self.push = torque[lanes], twist[lanes], push[lanes]
        self.before = Moment(angle[lanes], velocity[lanes], torque[lanes], torque[lanes])
        self.after = Moment(angle[lanes], frictionless_velocity[lanes], torque[lanes], torque[lanes])

    def transform_error(self, error: Array) -> None:
        """Replace the servo's errors by those that its controller responds to."""
        for transform in self.plant.servo_error:
            error[self.lanes] = transform(error[self.lanes])

    def subtract_lost_voltage(self, volts: Array, current: Array) -> None:
        """Subtract from the servo's voltage what is lost before the winding."""
        for lost_voltage in self.plant.lost_voltage:
            volts[self.lanes] -= lost_voltage(current[self.lanes])

    def scale_servo_torque(self, drive: Array, current: Array) -> None:
        """Scale the torque of a servo's current; a replayed current's torque is scaled already."""
        for share in self.plant.torque_share:
            drive[self.lanes] *= share(current[self.lanes])

    def remove_torque_in_play(self, stiffness: Array) -> None:
        """Remove the shaft's torque within its play, since flanks push and do not pull."""
        if self.plant.play:
            half_play = 0.5 * self.plant.play
            self.torque -= stiffness[self.lanes] * np.clip(self.twist, -half_play, half_play)
            self.torque *= (np.abs(self.twist) > half_play) & (self.torque * self.twist > 0.0)

    def drive(self, drive: Array, transmitted: Array) -> None:
        """Add the effects' torques on the rotor.

        transmitted : torque through the gear [N*m]; of a motor with a pendulum its own torque.
        """
        self.before.drive = self.after.drive = drive[self.lanes]
        self.before.transmitted = self.after.transmitted = transmitted[self.lanes]
        if not self.pushes:
            return
        for ripple in self.plant.ripple:
            self.push += self.before.drive * ripple(self.before)
        for torque in self.plant.rotor_torque:
            self.push += torque(self.before)
        for drag in self.plant.drag:
            self.push -= drag(self.before)

    def scale_friction(self, level: Array) -> None:
        """Scale the friction of this step in place."""
        if not self.rubs:
            return
        friction = level[self.lanes]
        for added in self.plant.coulomb_added:
            friction += self.gain * added(self.after)
        for share in self.plant.coulomb_share:
            friction *= share(self.after)
