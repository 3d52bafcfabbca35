"""How the heat of a winding is shared among its phases, and when it comes, while its rotor stands, crawls or turns.

Phase k takes (1 + cos(2 theta - 2 phi_k)) / 3 of the copper heat. The heat of every cycle stands at the angles that the
rotor passed in it, so that a current or a speed that keeps step with the rotor is seen. Between two samples the rotor
is taken to have turned evenly. What it may have done besides is loose heat: it counts as if it stood in the hottest
phase. See docs/decisions/0005.

A rotor that crawls heats one phase after the other: a short step sees a single one of them, half an electrical turn all
three alike. A span is heat from one moment to a later one, to be looked at as a single step.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.model.motor import Motor
from leactl.safety.thermal.bound import lateness
from leactl.safety.thermal.box import Array, Box

LED_LOOSE = 0.5  # of heat that two phases take in halves, which leaves (1 + 0.5) / 3 to each
DETOUR = 1.0 / 12.0  # mean distance from a straight line, over the largest second derivative and the square of the time
WINDOW = 32  # cycles, over which what an angle goes forth and back is noise
LEAST_RAD = 1e-9  # that is passed in place of nothing
FIELDS, HEAT, VELOCITY = 4, 1, 3  # numbers of a cycle in a log, and where some of them stand


@dataclass(slots=True)
class Span:
    """Heat of one actuator over some time, with its moments about the span's beginning."""

    duration: float = 0.0  # s
    square: float = 0.0  # A^2 s
    turned: complex = 0.0  # of it times e^(2j theta), by the measured angle
    swept: complex = 0.0  # the same by the measured velocity
    loose: float = 0.0  # A^2 s, which may be in any phase
    square_moment: float = 0.0  # A^2 s^2, and so on
    turned_moment: complex = 0.0
    swept_moment: complex = 0.0
    loose_moment: float = 0.0
    speed: float = 0.0  # rad/s, at the most
    unseen: float = 0.0  # s, from one sample to the next at the longest

    @property
    def aligned(self) -> float:
        """How far the current stood at one electrical angle, at the most."""
        stood = max(abs(self.turned), abs(self.swept)) + self.loose
        return min(1.0, stood / self.square) if self.square > 0.0 else 0.0

    def late(self, decay: float) -> float:
        """How much later than evenly a phase's heat may have come [s]; see `lateness`."""
        if not self.square > 0.0:
            return 0.0
        half = 0.5 * self.duration
        whole = self.square_moment - half * self.square
        if self.aligned < 1.0:
            loose = self.loose_moment - half * self.loose
            turning = max(abs(self.turned_moment - half * self.turned), abs(self.swept_moment - half * self.swept))
            behind = max(0.0, whole + loose) + turning
        else:  # no cycle heats a phase by more than twice its share
            behind = 2.0 * max(0.0, whole)
        return lateness(behind / (self.square * (1.0 + self.aligned)), self.duration, self.unseen, decay)

    def joined(self, after: "Span") -> "Span":
        """This one and the next."""
        before = self.duration
        return Span(
            before + after.duration,
            self.square + after.square,
            self.turned + after.turned,
            self.swept + after.swept,
            self.loose + after.loose,
            self.square_moment + after.square_moment + before * after.square,
            self.turned_moment + after.turned_moment + before * after.turned,
            self.swept_moment + after.swept_moment + before * after.swept,
            self.loose_moment + after.loose_moment + before * after.loose,
            max(self.speed, after.speed),
            max(self.unseen, after.unseen),
        )

    def lead(self, heat: float, moment: float, unseen: float) -> None:
        """Add heat of a direct current through two leads [A^2 s], with its moment [A^2 s^2].

        unseen : the longest time [s] from one look at that current to the next.
        """
        self.square += heat
        self.square_moment += moment
        self.loose += LED_LOOSE * heat
        self.loose_moment += LED_LOOSE * moment
        if heat > 0.0:
            self.unseen = max(self.unseen, unseen)


def fastest(motors: Iterable[Motor], most_current: float, most_speed: float) -> float:
    """How fast any rotor of a bench may be accelerated, by the largest current and friction of any of them [rad/s^2].

    Two rotors on one shaft are accelerated by the mean of what each would be by itself, weighted by inertia: no faster
    than the faster one. Inertias are as the motor files say; friction and current are the highest within tolerances.

    Parameters
    ----------
    most_current, most_speed : that the bench lets pass [A, rad/s].
    """
    highest = 0.0
    for motor in motors:
        box = Box.of(motor)
        friction = box.coulomb_friction.high + box.viscous_damping.high * most_speed
        torque = motor.torque_constant * most_current * box.current_gain + friction
        highest = max(highest, torque / motor.rotor_inertia)
    return highest


def detour(motor: Motor, acceleration: float) -> float:
    """How far from a straight line twice the electrical angle lies in the mean between two samples, at the most.

    In rad for each square second between them, where the rotor is accelerated by so much at the most [rad/s^2].
    """
    return DETOUR * 2.0 * motor.pole_pairs * acceleration


def top(velocities: Sequence[float], most_speed: float) -> float:
    """The highest of some speeds [rad/s]; the bench's where one is not known."""
    speed = float(np.abs(np.fromiter(velocities, float, len(velocities))).max(initial=0.0))
    return speed if math.isfinite(speed) else most_speed


class SensedMotion(NamedTuple):
    """How a rotor's two sensors told of its motion over some cycles, in the mean [rad/s]."""

    apart: float  # speed by the velocity and by the angle
    speed: float  # by the angle
    unsteady: float  # change of that from one cycle to the next, an encoder's steps included


class Rotor:
    """One actuator's rotor, cycle by cycle."""

    def __init__(self, motor: Motor, most_speed: float, fastest: float) -> None:
        """Of a rotor that is turned by no more than `fastest` [rad/s^2]."""
        self._twice_electrical, self._most_speed = 2.0 * motor.pole_pairs, most_speed
        self._detour = detour(motor, fastest)
        self._angle = self._velocity = math.nan  # of the last cycle
        self.lost = True  # whether the path by the velocity has a gap in the latest span, or at its beginning
        self._swept = 0.0  # twice the electrical angle by the velocity [rad]
        self._steps: Array = np.zeros(WINDOW)  # of the angle in the last cycles [rad]
        self.motion: SensedMotion | None = None  # in the latest span, where it was looked at and all of it is known

    def unlooked_at(self, square: float, velocities: Sequence[float], duration: float) -> Span:
        """A span of so little heat [A^2 s] that it may all be loose, and late: the work is saved."""
        self._angle = self._velocity = math.nan
        self.lost, self.motion = True, None
        speed = top(velocities, self._most_speed)
        moment = square * duration
        return Span(duration, square, 0.0, 0.0, square, moment, 0.0, 0.0, moment, speed)

    def span(self, log: Array, duration: float) -> Span:
        """The span of some cycles, the first of which follows the last one of the call before.

        An angle that goes forth and back within a few cycles is noisy by as much. Where it is not known, as at the
        beginning, or the velocity is not, all heat is loose.

        Parameters
        ----------
        log : of each cycle how long it lasted [s], heat [A^2 s], angle [rad] and velocity [rad/s] at its end, shape
            (cycles, 4); NaN is not known, and a velocity that is not counts as full speed.
        duration : of the span [s].
        """
        self.motion = None
        if not len(log):
            self.lost = not math.isnan(self._velocity)
            return Span(duration)
        cycles, heat, angles, velocities = np.ascontiguousarray(log.T)
        at = np.cumsum(cycles) - 0.5 * cycles
        whole, moment, speed, unseen = heat.sum(), heat @ at, np.abs(velocities).max(), cycles.max()
        added = Span(duration, float(whole), square_moment=float(moment), unseen=float(unseen))
        added.speed = self._most_speed if math.isnan(speed) else float(speed)
        before = np.concatenate([[self._velocity], velocities[:-1]])
        steps, swept_steps = np.diff(angles, prepend=self._angle), 0.5 * (velocities + before) * cycles
        passed = np.stack([steps, swept_steps]) * self._twice_electrical
        known = np.isfinite(passed)
        self.lost = not known[1].all()
        if known.all():
            self.motion = _motion(steps / cycles, swept_steps / cycles)
        else:
            steps, passed = np.where(known[0], steps, 0.0), np.where(known, passed, 0.0)
        angles_known, known = known[0], known[0] & known[1]
        loose = np.where(known, self._detour * cycles * cycles + self._twice_electrical * self._gone_back(steps), 1.0)
        swept = np.cumsum(passed[1]) + self._swept
        ends = np.stack([self._twice_electrical * np.where(angles_known, angles, 0.0), swept])
        own, loosely = heat * (loose < 1.0), heat * np.minimum(loose, 1.0)
        turned = own * evenly(ends - 0.5 * passed, passed)
        (added.turned, added.swept), moments = turned.sum(axis=1).tolist(), turned @ at
        added.turned_moment, added.swept_moment = moments.tolist()
        added.loose, added.loose_moment = float(loosely.sum()), float(loosely @ at)
        self._angle, self._velocity = float(angles[-1]), float(velocities[-1])
        self._swept = float(swept[-1]) % (2.0 * math.pi)
        return added

    def _gone_back(self, steps: Array) -> Array:
        """How far the angle has gone back over `WINDOW` cycles, at each [rad]: what is no net travel is noise."""
        steps = np.concatenate([self._steps, steps])
        self._steps = steps[-WINDOW:]
        if steps.min() >= 0.0 or steps.max() <= 0.0:
            return np.zeros(len(steps) - WINDOW)
        forth, back = (np.concatenate([[0.0], np.cumsum(np.maximum(way, 0.0))]) for way in (steps, -steps))
        both = np.minimum(forth[WINDOW:] - forth[:-WINDOW], back[WINDOW:] - back[:-WINDOW])
        return np.asarray(both[1:], np.float64)


def _motion(by_angle: Array, by_velocity: Array) -> SensedMotion:
    unsteady = float(np.abs(np.diff(by_angle)).mean()) if len(by_angle) > 1 else math.inf
    return SensedMotion(float(np.abs(by_velocity - by_angle).mean()), float(np.abs(by_angle).mean()), unsteady)


def evenly(middle: Array, passed: Array) -> npt.NDArray[np.complex128]:
    """Mean of e^(j angle) over as much as is passed evenly around a middle [rad]."""
    half = 0.5 * passed
    half[half == 0.0] = LEAST_RAD
    return np.asarray(np.exp(1j * middle) * (np.sin(half) / half), np.complex128)
