"""Rotors on a shaft, many stretches of many runs stepped side by side.

The shaft is a spring between two rotors (leap-frog: velocities between the instants, angles and torques at them). A
free rotor has no spring, a locked one an end that does not move. At standstill friction opposes up to its Coulomb
level: the test rotor's as bristles that bend a little before they slide (Dahl, 1968), as those of any bearing do, the
load's by taking what moves it, down to standstill and no further.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.effects.plant import Moment, Plant

Array = npt.NDArray[np.float64]
BRISTLE_DAMPING = 0.2  # of critical, while bristles bend: without it a rotor that sticks would ring for ever
SHAFT_DAMPING = 0.03  # of critical, as steel shafts with clamped couplings have
STIFFEST = 1.0  # rad, half the phase that a shaft's resonance may turn in a step; a stiffer one is as good as rigid


@dataclass
class LaneState:
    """Where each lane stands."""

    angle: Array  # rad, of the test rotor
    velocity: Array  # rad/s, half a step earlier
    load_velocity: Array
    twist: Array  # rad
    bristle: Array  # -1 .. 1, friction that has built up

    def picked(self, lanes: npt.NDArray[np.intp]) -> "LaneState":
        """Some of the lanes."""
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
    held: int  # steps, for which a reference stays as it is


@dataclass
class Tracking:
    """A torque that keeps a rotor near a motion: a spring and a damper between the two."""

    angle: Array  # rad, (steps, lanes)
    velocity: Array  # rad/s, (steps, lanes)
    stiffness: Array  # N*m/rad
    damping: Array  # N*m*s/rad


@dataclass
class Lanes:
    """Stretches of runs with the constants of their benches; each array has one value a lane, inputs one a step too."""

    step: float  # s
    plants: Sequence[tuple[Plant, slice]]  # lanes of one bench stand together
    drive: Array  # N*m, (steps, lanes)
    load_drive: Array | None  # N*m, (steps, lanes)
    friction_share: Array | None  # factor, (steps, lanes)
    inertia: Array  # kg*m^2
    damping: Array  # N*m*s/rad
    emf_damping: Array  # N*m*s/rad, of the back-EMF under a voltage that is given
    friction: Array  # N*m
    load_inertia: Array  # kg*m^2; infinite where the shaft's end is held
    load_damping: Array
    load_friction: Array
    stiffness: Array  # N*m/rad; zero where nothing is on the shaft
    damping_ratio: Array  # of critical, of the shaft
    gravity: Array  # N*m, of a pendulum or arm held out level
    hanging: Array  # rad, at which it hangs straight down
    servo: Servo | None = None
    tracking: Tracking | None = None


@dataclass
class LaneMotion:
    """What the lanes did, (steps, lanes)."""

    angle: Array
    velocity: Array  # over each step
    torque: Array
    load_velocity: Array
    current: Array | None
    pull: Array | None  # N*m, that tracking adds to the drive
    end: LaneState


def resonant_stiffness(lanes: Lanes) -> Array:
    """Stiffness with which steps of this length ring at the shaft's own frequency."""
    mobility = 1.0 / lanes.inertia + 1.0 / lanes.load_inertia
    half = 0.5 * lanes.step * np.sqrt(lanes.stiffness * mobility)
    return np.asarray(np.sin(np.minimum(half, STIFFEST)) ** 2 * 4.0 / (lanes.step**2 * mobility), np.float64)


def stepped(lanes: Lanes, start: LaneState) -> LaneMotion:
    """Step every lane to its end."""
    steps, count = lanes.drive.shape
    h = lanes.step
    servo = lanes.servo
    # at a step's start, half a step late, back-EMF would make an axis lighter and throw a light one to and fro
    braking = servo.torque_constant * servo.emf / servo.resistance if servo is not None else np.zeros(count)
    decay, gain = _answer(lanes.damping + lanes.emf_damping + braking, lanes.inertia, h)
    free = _answer(lanes.damping + lanes.emf_damping, lanes.inertia, h)  # where a servo is off, no current brakes
    load_decay, load_gain = _answer(lanes.load_damping, lanes.load_inertia, h)
    stiffness = resonant_stiffness(lanes)
    yielding = 2.0 * lanes.damping_ratio * np.sqrt(stiffness / (1.0 / lanes.inertia + 1.0 / lanes.load_inertia))
    bristles = _Bristles(lanes, gain)
    shaft, hanging = bool(np.any(stiffness > 0)), bool(np.any(lanes.gravity != 0))
    loaded, fed = shaft and bool(np.any(load_gain > 0)), bool(np.any(lanes.emf_damping > 0))
    held, load_held = gain * lanes.friction, load_gain * lanes.load_friction
    groups = [_Group(plant, place, gain) for plant, place in lanes.plants]
    groups = [group for group in groups if group.acts]
    angle, velocity = start.angle.copy(), start.velocity.copy()
    load_velocity, twist, bristle = start.load_velocity.copy(), start.twist.copy(), start.bristle.copy()
    ahead, push, torque = np.empty(count), np.empty(count), np.zeros(count)
    shape = (steps, count)
    current = np.empty(shape) if servo is not None else None
    pull = np.empty(shape) if lanes.tracking is not None else None
    out = LaneMotion(np.empty(shape), np.empty(shape), np.zeros(shape), np.zeros(shape), current, pull, start)
    for group in groups:
        group.attach(angle, velocity, ahead, torque, twist, push)
    for index in range(steps):
        drive = lanes.drive[index]
        if out.pull is not None:
            out.pull[index] = _pull(lanes.tracking, index, angle, velocity)
            drive = drive + out.pull[index]
        if servo is not None and out.current is not None:
            flowing = out.current[index] = _servo_current(servo, lanes.step, index, angle, velocity, groups)
            drive = servo.torque_constant * flowing
            for group in groups:
                group.saturate(drive, flowing)
        if shaft:
            np.multiply(stiffness, twist, out=torque)
            torque += yielding * (velocity - load_velocity)
            for group in groups:
                group.slip(stiffness)
        elif hanging:
            np.multiply(lanes.gravity, np.sin(angle - lanes.hanging), out=torque)
        np.subtract(drive, torque, out=push)
        at_once, at_length, hold = decay, gain, held
        if servo is not None:
            idle = np.isnan(servo.reference[index])
            push += np.where(idle, 0.0, braking * velocity)  # a current has its back-EMF in it, and so has the decay
            if idle.any():
                at_once, at_length = np.where(idle, free[0], decay), np.where(idle, free[1], gain)
                hold = at_length * lanes.friction
        out.torque[index] = torque
        out.angle[index] = angle
        level = hold
        if groups:
            if lanes.friction_share is not None:
                more = lanes.friction_share[index]
                level = hold * more
                push -= (more - 1.0) * lanes.damping * velocity
            elif any(group.rubs for group in groups):
                level = hold.copy()
            made = drive - lanes.emf_damping * velocity if fed else drive
            for group in groups:
                group.drive(made, made if hanging else torque)
        np.multiply(velocity, at_once, out=ahead)
        push *= at_length
        ahead += push
        for group in groups:
            group.rub(level)
        bristles.take(level, ahead, bristle, velocity)
        out.velocity[index] = velocity
        angle += h * velocity
        if shaft:
            twist += h * velocity
            if loaded:
                assert lanes.load_drive is not None
                ahead_load = load_decay * load_velocity + load_gain * (lanes.load_drive[index] + torque)
                load_velocity = ahead_load - np.minimum(np.maximum(ahead_load, -load_held), load_held)
                twist -= h * load_velocity
                out.load_velocity[index] = load_velocity
    out.end = LaneState(angle, velocity, load_velocity, twist, bristle)
    if shaft:
        take_up(out, lanes, stiffness)
    return out


def take_up(motion: LaneMotion, lanes: Lanes, stiffness: Array) -> None:
    """Correct the motion for the softer spring of the steps: a twist is the torque over the stiffness of the shaft.

    The softer spring twists too much. The excess is removed where no balance of torques reads it: the load's speed is
    raised, a locked rotor's angle and speed are lowered.
    """
    softer, shaft = np.zeros_like(stiffness), lanes.stiffness > 0.0
    softer[shaft] = 1.0 / stiffness[shaft] - 1.0 / lanes.stiffness[shaft]
    too_far = softer * motion.torque
    faster = np.diff(too_far, axis=0, append=too_far[-1:]) / lanes.step
    held = np.isinf(lanes.load_inertia)
    motion.angle -= np.where(held, too_far, 0.0)
    motion.velocity -= np.where(held, faster, 0.0)
    motion.load_velocity += np.where(held, 0.0, faster)


def _servo_current(
    servo: Servo, step: float, index: int, angle: Array, velocity: Array, groups: "list[_Group]"
) -> Array:
    """What the servo's voltage drives through the winding, none while it is disabled."""
    wanted = servo.reference[index]
    error = wanted - angle
    for group in groups:
        group.answer(error)
    volts = servo.gain * error
    if np.any(servo.damping):
        volts += servo.damping * (_hasty(servo, step, index) - velocity)
    volts = np.clip(volts, -servo.limit, servo.limit)
    flowing = (volts - servo.emf * velocity) / servo.resistance
    for group in groups:
        group.lose(volts, flowing)
        flowing = (volts - servo.emf * velocity) / servo.resistance
    return np.where(np.isnan(wanted), 0.0, flowing)


def _hasty(servo: Servo, step: float, index: int) -> Array:
    """Speed [rad/s] of what the servo follows, over as many steps as it stays the same for; none where it begins."""
    behind = servo.reference[max(index - servo.held, 0)]
    moved = (servo.reference[index] - behind) / (servo.held * step)
    return np.asarray(np.nan_to_num(moved), np.float64)


def _pull(tracking: Tracking | None, index: int, angle: Array, velocity: Array) -> Array:
    """Torque of the spring and the damper to the motion that is tracked."""
    assert tracking is not None
    pull = tracking.stiffness * (tracking.angle[index] - angle)
    return np.asarray(pull + tracking.damping * (tracking.velocity[index] - velocity), np.float64)


def _answer(damping: Array, inertia: Array, step: float) -> tuple[Array, Array]:
    """Decay of a velocity over a step, and what a torque adds to it: exact for a damped inertia."""
    rate = damping / inertia * step
    gain = np.where(rate > 1e-9, -np.expm1(-rate) / np.where(rate > 1e-9, rate, 1.0), 1.0) * step / inertia
    return np.where(np.isinf(inertia), 0.0, np.exp(-rate)), np.asarray(gain, np.float64)


class _Bristles:
    """Friction of the test rotors, as what bends and then slides."""

    def __init__(self, lanes: Lanes, gain: Array) -> None:
        reach = np.empty(len(gain))
        for plant, place in lanes.plants:
            reach[place] = plant.bristle or plant.give
        # bristles stiffer than a step resolves would drive the rotor back and forth
        reach = np.maximum(reach, 0.5 * lanes.step * gain * lanes.friction)
        self.per_turn = lanes.step / reach
        self.damping = 2.0 * BRISTLE_DAMPING * gain * np.sqrt(lanes.friction / reach * lanes.inertia)

    def take(self, level: Array, ahead: Array, bristle: Array, velocity: Array) -> None:
        """Take from the velocity ahead what friction of this level holds back, and bend on."""
        np.abs(bristle, out=velocity)
        np.subtract(1.0, velocity, out=velocity)
        velocity *= self.damping
        velocity += 1.0
        ahead -= level * bristle
        np.divide(ahead, velocity, out=velocity)
        turned = self.per_turn * velocity
        bristle += turned
        bristle /= 1.0 + np.abs(turned)


class _Group:
    """Effects of one bench on its lanes."""

    def __init__(self, plant: Plant, place: slice, gain: Array) -> None:
        self.plant, self.place, self.gain = plant, place, gain[place]
        self.pushes = bool(plant.ripple or plant.rotor_torque or plant.drag)
        self.rubs = bool(plant.coulomb_share or plant.coulomb_added)
        electric = plant.lost_voltage or plant.torque_share or plant.servo_error
        self.acts = self.pushes or self.rubs or bool(plant.play or electric or plant.friction_share)

    def attach(self, angle: Array, velocity: Array, ahead: Array, torque: Array, twist: Array, push: Array) -> None:
        """Look at this bench's part of what all lanes share; the stepper keeps it up to date."""
        own = self.place
        self.torque, self.twist, self.push = torque[own], twist[own], push[own]
        self.before = Moment(angle[own], velocity[own], torque[own], torque[own])
        self.after = Moment(angle[own], ahead[own], torque[own], torque[own])

    def answer(self, error: Array) -> None:
        """Leave of the servo's errors what its controller answers."""
        for answered in self.plant.servo_error:
            error[self.place] = answered(error[self.place])

    def lose(self, volts: Array, current: Array) -> None:
        """Take from the voltage what the winding does not see."""
        for lost in self.plant.lost_voltage:
            volts[self.place] -= lost(current[self.place])

    def saturate(self, drive: Array, flowing: Array) -> None:
        """Scale the torque of a servo's current; that of a replayed current comes scaled."""
        for share in self.plant.torque_share:
            drive[self.place] *= share(flowing[self.place])

    def slip(self, stiffness: Array) -> None:
        """Leave the shaft unstrained within its play, whose flanks press and do not pull."""
        if self.plant.play:
            half = 0.5 * self.plant.play
            self.torque -= stiffness[self.place] * np.clip(self.twist, -half, half)
            self.torque *= (np.abs(self.twist) > half) & (self.torque * self.twist > 0.0)

    def drive(self, drive: Array, transmitted: Array) -> None:
        """Add torques on the rotor; a gear below a pendulum transmits what its motor puts in."""
        self.before.drive = self.after.drive = drive[self.place]
        self.before.transmitted = self.after.transmitted = transmitted[self.place]
        if not self.pushes:
            return
        for ripple in self.plant.ripple:
            self.push += self.before.drive * ripple(self.before)
        for torque in self.plant.rotor_torque:
            self.push += torque(self.before)
        for drag in self.plant.drag:
            self.push -= drag(self.before)

    def rub(self, level: Array) -> None:
        """Scale the friction of this step."""
        if not self.rubs:
            return
        own = level[self.place]
        for added in self.plant.coulomb_added:
            own += self.gain * added(self.after)
        for share in self.plant.coulomb_share:
            own *= share(self.after)
