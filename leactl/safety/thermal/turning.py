"""Distribution of a winding's heat over its phases and over time, while its rotor stands, crawls or turns.

Phase k takes (1 + cos(2 theta - 2 phi_k)) / 3 of the copper heat. The heat of every cycle is assigned to the angles
that the rotor passed in it, so that a current or a speed that keeps step with the rotor is seen. Between two samples
the rotor is assumed to turn evenly. Heat whose angle is uncertain is called loose: it counts as if it came at the
angle of the hottest phase. See docs/decisions/0005.

A rotor that crawls heats one phase after the other: a short step heats a single phase, half an electrical turn heats
all three alike. A span is the heat between two moments, and the thermal bound takes it as a single step.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.model.motor import Motor
from leactl.safety.thermal.box import Array, Box
from leactl.safety.thermal.temperature_bound import delay_bound

LEAD_LOOSE_SHARE = 0.5  # loose share of heat that two phases take in halves: each takes (1 + 0.5) / 3
# mean distance from a straight line, over the largest second derivative and the square of the time
DETOUR_FACTOR = 1.0 / 12.0
NOISE_CYCLES = 32  # an angle that goes forth and back within as many cycles is noisy
SMALLEST_ANGLE_RAD = 1e-9  # replaces a passed angle of 0 in sin(x) / x
FIELDS, HEAT, VELOCITY = 4, 1, 3  # numbers of a cycle in a log, and the positions of two of them


@dataclass(slots=True)
class Span:
    """Heat of one actuator over some time, with its first moments in time about the beginning of the span."""

    duration: float = 0.0  # s
    square: float = 0.0  # A^2 s
    angle_phasor: complex = 0.0  # A^2 s, heat times e^(2j theta), by the measured angle
    velocity_phasor: complex = 0.0  # A^2 s, the same by the measured velocity
    loose: float = 0.0  # A^2 s, heat that may be in any phase
    square_moment: float = 0.0  # A^2 s^2, as the three moments below
    angle_phasor_moment: complex = 0.0
    velocity_phasor_moment: complex = 0.0
    loose_moment: float = 0.0
    speed: float = 0.0  # rad/s, at the most
    longest_gap: float = 0.0  # s, longest time between two samples

    @property
    def aligned(self) -> float:
        """Upper bound of |mean i^2 e^(2j theta)| / mean i^2: 1 at standstill, 0 over whole turns."""
        largest = max(abs(self.angle_phasor), abs(self.velocity_phasor)) + self.loose
        return min(1.0, largest / self.square) if self.square > 0.0 else 0.0

    def delay(self, decay: float) -> float:
        """Return an upper bound of the delay of a phase's heat behind heat that comes evenly over the span [s].

        decay : shortest time constant of the winding [s]; see `delay_bound`.
        """
        if not self.square > 0.0:
            return 0.0
        middle = 0.5 * self.duration
        square_offset = self.square_moment - middle * self.square
        if self.aligned < 1.0:
            loose_offset = self.loose_moment - middle * self.loose
            phasor_offset = max(
                abs(self.angle_phasor_moment - middle * self.angle_phasor),
                abs(self.velocity_phasor_moment - middle * self.velocity_phasor),
            )
            delayed_heat = max(0.0, square_offset + loose_offset) + phasor_offset
        else:  # no cycle heats a phase by more than twice its share
            delayed_heat = 2.0 * max(0.0, square_offset)
        return delay_bound(delayed_heat / (self.square * (1.0 + self.aligned)), self.duration, self.longest_gap, decay)

    def joined(self, following: "Span") -> "Span":
        """Return the span that covers this span and the span `following` it."""
        offset = self.duration
        return Span(
            offset + following.duration,
            self.square + following.square,
            self.angle_phasor + following.angle_phasor,
            self.velocity_phasor + following.velocity_phasor,
            self.loose + following.loose,
            self.square_moment + following.square_moment + offset * following.square,
            self.angle_phasor_moment + following.angle_phasor_moment + offset * following.angle_phasor,
            self.velocity_phasor_moment + following.velocity_phasor_moment + offset * following.velocity_phasor,
            self.loose_moment + following.loose_moment + offset * following.loose,
            max(self.speed, following.speed),
            max(self.longest_gap, following.longest_gap),
        )

    def add_lead_heat(self, heat: float, moment: float, longest_gap: float) -> None:
        """Add the heat of a direct current through two leads [A^2 s], with its moment [A^2 s^2].

        longest_gap : longest time between two samples of that current [s].
        """
        self.square += heat
        self.square_moment += moment
        self.loose += LEAD_LOOSE_SHARE * heat
        self.loose_moment += LEAD_LOOSE_SHARE * moment
        if heat > 0.0:
            self.longest_gap = max(self.longest_gap, longest_gap)


def largest_acceleration(motors: Iterable[Motor], most_current: float, most_speed: float) -> float:
    """Return the largest acceleration that the largest current and friction give any rotor of a bench [rad/s^2].

    Two rotors on one shaft accelerate by the mean of their separate accelerations, weighted by inertia: no faster than
    the faster one. Inertias are those of the motor files; friction and current are the highest within tolerances.

    Parameters
    ----------
    most_current, most_speed : limits of the bench [A, rad/s].
    """
    largest = 0.0
    for motor in motors:
        box = Box.of(motor)
        friction = box.coulomb_friction.high + box.viscous_damping.high * most_speed
        torque = motor.torque_constant * most_current * box.current_gain + friction
        largest = max(largest, torque / motor.rotor_inertia)
    return largest


def detour(motor: Motor, acceleration: float) -> float:
    """Return the largest mean distance of twice the electrical angle from a straight line between two samples.

    The distance is in rad over the square of the time between the samples [rad/s^2].

    acceleration : largest acceleration of the rotor [rad/s^2].
    """
    return DETOUR_FACTOR * 2.0 * motor.pole_pairs * acceleration


def highest_speed(velocities: Sequence[float], most_speed: float) -> float:
    """Return the highest speed among some velocities, or `most_speed` if any of them is not finite [rad/s]."""
    speed = float(np.abs(np.fromiter(velocities, float, len(velocities))).max(initial=0.0))
    return speed if math.isfinite(speed) else most_speed


class SensedMotion(NamedTuple):
    """Motion of a rotor by its velocity and by its angle, means over some cycles [rad/s]."""

    difference: float  # magnitude of the difference between the velocity and the rate of the angle
    speed: float  # by the angle
    unsteadiness: float  # change of the rate of the angle from one cycle to the next, including an encoder's steps


class Rotor:
    """Rotor of one actuator, which sums heat, angle and velocity of its cycles up in spans."""

    def __init__(self, motor: Motor, most_speed: float, acceleration: float) -> None:
        """Begin with an unknown angle; the rotor is accelerated by no more than `acceleration` [rad/s^2]."""
        self._twice_pole_pairs, self._most_speed = 2.0 * motor.pole_pairs, most_speed
        self._detour_factor = detour(motor, acceleration)
        self._angle = self._velocity = math.nan  # of the last cycle
        self.path_has_gap = True  # whether the angle by the velocity has a gap in the latest span, or at its beginning
        self._velocity_path = 0.0  # twice the electrical angle by the velocity [rad]
        self._steps: Array = np.zeros(NOISE_CYCLES)  # of the angle in the last cycles [rad]
        self.motion: SensedMotion | None = None  # in the latest span; None where any angle or velocity is not known

    def loose_span(self, square: float, velocities: Sequence[float], duration: float) -> Span:
        """Return a span whose heat `square` [A^2 s] is all loose and comes at its end.

        It takes little time to compute and is for very little heat, because it bounds the temperature from far above.

        Parameters
        ----------
        velocities : velocity at the end of each cycle [rad/s].
        duration : of the span [s].
        """
        self._angle = self._velocity = math.nan
        self.path_has_gap, self.motion = True, None
        speed = highest_speed(velocities, self._most_speed)
        moment = square * duration
        return Span(duration, square, 0.0, 0.0, square, moment, 0.0, 0.0, moment, speed)

    def span(self, log: Array, duration: float) -> Span:
        """Return the span of some cycles, the first of which follows the last cycle of the previous call.

        An angle that goes forth and back within `NOISE_CYCLES` is noisy by as much. All heat of a cycle is loose if its
        angle or its velocity is not known; at the beginning neither is.

        Parameters
        ----------
        log : duration [s], heat [A^2 s], and angle [rad] and velocity [rad/s] at the end of each cycle, shape
            (cycles, 4); NaN where not known. An unknown velocity counts as the highest speed of the bench.
        duration : of the span [s].
        """
        self.motion = None
        if not len(log):
            self.path_has_gap = not math.isnan(self._velocity)
            return Span(duration)
        cycle_durations, heat, angles, velocities = np.ascontiguousarray(log.T)
        cycle_middles = np.cumsum(cycle_durations) - 0.5 * cycle_durations
        total, moment, speed, longest_gap = (
            heat.sum(),
            heat @ cycle_middles,
            np.abs(velocities).max(),
            cycle_durations.max(),
        )
        span = Span(duration, float(total), square_moment=float(moment), longest_gap=float(longest_gap))
        span.speed = self._most_speed if math.isnan(speed) else float(speed)
        previous_velocities = np.concatenate([[self._velocity], velocities[:-1]])
        steps, velocity_steps = (
            np.diff(angles, prepend=self._angle),
            0.5 * (velocities + previous_velocities) * cycle_durations,
        )
        passed_angles = np.stack([steps, velocity_steps]) * self._twice_pole_pairs
        is_finite = np.isfinite(passed_angles)
        self.path_has_gap = not is_finite[1].all()
        if is_finite.all():
            self.motion = _motion(steps / cycle_durations, velocity_steps / cycle_durations)
        else:
            steps, passed_angles = np.where(is_finite[0], steps, 0.0), np.where(is_finite, passed_angles, 0.0)
        angle_is_known, both_are_known = is_finite[0], is_finite[0] & is_finite[1]
        loose_share = np.where(
            both_are_known,
            self._detour_factor * cycle_durations * cycle_durations + self._twice_pole_pairs * self._travel_back(steps),
            1.0,
        )
        path = np.cumsum(passed_angles[1]) + self._velocity_path
        end_angles = np.stack([self._twice_pole_pairs * np.where(angle_is_known, angles, 0.0), path])
        resolved_heat, loose_heat = heat * (loose_share < 1.0), heat * np.minimum(loose_share, 1.0)
        phasors = resolved_heat * mean_phasor(end_angles - 0.5 * passed_angles, passed_angles)
        (span.angle_phasor, span.velocity_phasor), moments = phasors.sum(axis=1).tolist(), phasors @ cycle_middles
        span.angle_phasor_moment, span.velocity_phasor_moment = moments.tolist()
        span.loose, span.loose_moment = float(loose_heat.sum()), float(loose_heat @ cycle_middles)
        self._angle, self._velocity = float(angles[-1]), float(velocities[-1])
        self._velocity_path = float(path[-1]) % (2.0 * math.pi)
        return span

    def _travel_back(self, steps: Array) -> Array:
        """Return the travel without net progress in the `NOISE_CYCLES` up to each cycle [rad], which is noise."""
        steps = np.concatenate([self._steps, steps])
        self._steps = steps[-NOISE_CYCLES:]
        if steps.min() >= 0.0 or steps.max() <= 0.0:
            return np.zeros(len(steps) - NOISE_CYCLES)
        forward_travel, backward_travel = (
            np.concatenate([[0.0], np.cumsum(np.maximum(direction_steps, 0.0))]) for direction_steps in (steps, -steps)
        )
        travel_back = np.minimum(
            forward_travel[NOISE_CYCLES:] - forward_travel[:-NOISE_CYCLES],
            backward_travel[NOISE_CYCLES:] - backward_travel[:-NOISE_CYCLES],
        )
        return np.asarray(travel_back[1:], np.float64)


def _motion(by_angle: Array, by_velocity: Array) -> SensedMotion:
    """Return the motion of a rotor, given its speed in each of some cycles by the angle and by the velocity [rad/s]."""
    unsteadiness = float(np.abs(np.diff(by_angle)).mean()) if len(by_angle) > 1 else math.inf
    return SensedMotion(float(np.abs(by_velocity - by_angle).mean()), float(np.abs(by_angle).mean()), unsteadiness)


def mean_phasor(middle: Array, passed_angle: Array) -> npt.NDArray[np.complex128]:
    """Return the mean of e^(j angle) over angles passed evenly, within `passed_angle` about `middle` [rad]."""
    half_angle = 0.5 * passed_angle
    half_angle[half_angle == 0.0] = SMALLEST_ANGLE_RAD
    return np.asarray(np.exp(1j * middle) * (np.sin(half_angle) / half_angle), np.complex128)
