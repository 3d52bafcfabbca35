"""How the heat of a winding is shared among its phases, and when it comes, while its rotor stands, crawls or turns.

Phase k takes (1 + cos(2 theta - 2 phi_k)) / 3 of the copper heat. The heat of every cycle stands at the angles that the
rotor passed in it, so that a current or a speed that keeps step with the rotor is seen. Between two samples the rotor
is taken to have turned evenly. What it may have done besides is loose heat: it counts as if it stood in the hottest
phase. See docs/decisions/0005.

A rotor that crawls heats one phase after the other: a short step sees a single one of them, half an electrical turn all
three alike. A span is heat from one moment to a later one, to be looked at as a single step.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.model.motor import Motor
from leactl.safety.thermal.bound import lateness
from leactl.safety.thermal.box import Array

LED_LOOSE = 0.5  # of heat that two phases take in halves, which leaves (1 + 0.5) / 3 to each
DETOUR = 1.0 / 12.0  # mean distance from a straight line, over the largest second derivative and the square of the time
WINDOW = 32  # cycles, over which what an angle goes forth and back is noise
FIELDS = 3  # of a cycle in a log: heat [A^2 s], angle [rad], velocity [rad/s]


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
        even = self.square_moment - half * self.square + self.loose_moment - half * self.loose
        turning = max(
            abs(self.turned_moment - half * self.turned),
            abs(self.swept_moment - half * self.swept),
        )
        behind = max(0.0, even) + turning
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

    def lead(self, heat: float) -> None:
        """Add heat of a direct current through two leads [A^2 s], which comes evenly."""
        self.square += heat
        self.square_moment += heat * 0.5 * self.duration
        self.loose += LED_LOOSE * heat
        self.loose_moment += LED_LOOSE * heat * 0.5 * self.duration


def detour(motor: Motor, most_current: float, most_speed: float, interval: float) -> float:
    """How far from a straight line twice the electrical angle lies in the mean between two samples, at the most [rad].

    Nothing but currents and friction accelerates a rotor, as far as the motor file tells its inertia. Of two actuators
    on one shaft each brings its own, so that neither is accelerated any faster than by itself.

    Parameters
    ----------
    most_current, most_speed : that the bench lets pass [A, rad/s].
    interval : from one sample to the next [s].
    """
    torque = motor.torque_constant * most_current + motor.coulomb_friction + motor.viscous_damping * most_speed
    return DETOUR * 2.0 * motor.pole_pairs * torque / motor.rotor_inertia * interval * interval


class Rotor:
    """One actuator's rotor, cycle by cycle."""

    def __init__(self, motor: Motor, most_current: float, most_speed: float) -> None:
        self._twice_electrical, self._most_speed = 2.0 * motor.pole_pairs, most_speed
        self._detour = detour(motor, most_current, most_speed, 1.0)
        self._angle = self._velocity = math.nan  # of the last cycle
        self._swept = 0.0  # twice the electrical angle by the velocity [rad]
        self._steps: Array = np.zeros(WINDOW)  # of the angle in the last cycles [rad]

    def span(self, cycles: Array, log: Array, duration: float) -> Span:
        """The span of some cycles, the first of which follows the last one of the call before.

        An angle that goes forth and back within a few cycles is noisy by as much. Where it is not known, as at the
        beginning, or the velocity is not, all heat is loose.

        Parameters
        ----------
        cycles : how long each lasted [s].
        log : heat [A^2 s], angle [rad] and velocity [rad/s] at the end of each, shape (cycles, 3); NaN is not known,
            and a velocity that is not counts as full speed.
        duration : of the span [s].
        """
        if not len(cycles):
            return Span(duration)
        heat = log[:, 0]
        angles, velocities = np.concatenate([[[self._angle, self._velocity]], log[:, 1:]]).T
        steps = np.diff(angles)
        passed = self._twice_electrical * 0.5 * (velocities[1:] + velocities[:-1]) * cycles
        known = np.isfinite(steps) & np.isfinite(passed)
        steps, passed = np.where(known, steps, 0.0), np.where(known, passed, 0.0)
        loose = np.minimum(self._detour * cycles * cycles + self._twice_electrical * self._gone_back(steps), 1.0)
        loose[~known] = 1.0
        own = np.where(loose < 1.0, heat, 0.0)
        begins = self._swept + np.cumsum(passed) - passed
        turns = self._twice_electrical * np.where(known, angles[:-1], 0.0)
        at = np.cumsum(cycles) - 0.5 * cycles
        turned = own * evenly(turns, self._twice_electrical * steps)
        swept = own * evenly(begins, passed)
        loosely = heat * loose
        self._angle, self._velocity = float(angles[-1]), float(velocities[-1])
        self._swept = math.remainder(float(begins[-1] + passed[-1]), 2.0 * math.pi)
        return Span(
            duration,
            float(heat.sum()),
            complex(turned.sum()),
            complex(swept.sum()),
            float(loosely.sum()),
            float(heat @ at),
            complex(turned @ at),
            complex(swept @ at),
            float(loosely @ at),
            float(np.max(np.where(np.isfinite(velocities[1:]), np.abs(velocities[1:]), self._most_speed))),
            float(cycles.max()),
        )

    def _gone_back(self, steps: Array) -> Array:
        """How far the angle has gone back over `WINDOW` cycles, at each [rad]: what is no net travel is noise."""
        steps = np.concatenate([self._steps, steps])
        self._steps = steps[-WINDOW:]
        forth, back = (np.concatenate([[0.0], np.cumsum(np.maximum(way, 0.0))]) for way in (steps, -steps))
        both = np.minimum(forth[WINDOW:] - forth[:-WINDOW], back[WINDOW:] - back[:-WINDOW])
        return np.asarray(both[1:], np.float64)


def evenly(begin: Array, passed: Array) -> npt.NDArray[np.complex128]:
    """Mean of e^(j angle) over angles that are passed evenly from `begin` on [rad]."""
    half = 0.5 * passed
    return np.asarray(np.exp(1j * (begin + half)) * np.sinc(half / np.pi), np.complex128)
