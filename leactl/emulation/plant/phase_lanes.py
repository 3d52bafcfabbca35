"""Hottest phase of many lanes at once over given currents and velocities, without devices.

It serves a Monte Carlo over protocols: it is the emulated bench's plant with resolved phases, without mechanics.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from leactl.emulation.plant.parameters import ActuatorParameters, Checked, bounded, switch
from leactl.emulation.plant.phases import Array, PhaseNetwork, lead_squares, turning_squares

BLOCK = 128  # intervals whose currents are split at once: a block of 200 lanes stays in the processor's cache


@dataclass(frozen=True)
class PhaseLane(Checked):
    """One actuator at its ambient temperature, and the true current relative to its drive's."""

    actuator: ActuatorParameters = field(default_factory=ActuatorParameters)
    ambient_temperature: float = bounded(25.0, -100.0, 200.0)  # degC
    current_factor: float = bounded(1.0, 0.01, 100.0)  # true current over the drive's: sqrt(3/2) for a wrong convention
    friction_heat: bool = switch(True)  # into the housing
    angle: float = bounded(0.0, -1e6, 1e6)  # rad, of the rotor at the start


class PhaseLanes:
    """Lanes with one constant interval [s]; each call of `run` continues where the last one ended."""

    def __init__(self, lanes: Sequence[PhaseLane], interval_s: float = 0.01) -> None:
        actuators = [lane.actuator for lane in lanes]
        self.network = PhaseNetwork(actuators, [lane.ambient_temperature for lane in lanes])
        self._interval = interval_s
        self._squared_current_factor = np.array([lane.current_factor**2 for lane in lanes])
        pole_pairs = np.array([float(a.pole_pairs) for a in actuators])
        self._electrical_angle_per_speed = pole_pairs * interval_s
        offsets = np.array([a.phases.commutation_offset for a in actuators])
        self._angle = pole_pairs * [lane.angle for lane in lanes] + offsets  # rad, electrical
        has_friction_heat = np.array([float(lane.friction_heat) for lane in lanes])
        self._damping = has_friction_heat * [a.viscous_damping for a in actuators]
        self._coulomb = has_friction_heat * [a.coulomb_friction for a in actuators]

    def run(self, current: Array, velocity: Array, line_current: Array | None = None) -> Array:
        """Return the temperature of the hottest phase [degC] at the end of every interval, shape (intervals, lanes).

        `current` is the q-axis current as the drive reports it [A], `velocity` the rotor's [rad/s], `line_current` the
        direct current through two leads [A]; each is constant over its interval and has the shape of the result.
        """
        hottest = np.empty(current.shape)
        for first_interval in range(0, len(current), BLOCK):
            block = slice(first_interval, first_interval + BLOCK)
            squares = self._squares(current[block], velocity[block])
            if line_current is not None:
                squares += lead_squares(line_current[block] ** 2)
            speed = np.abs(velocity[block])
            friction = (self._damping * speed + self._coulomb) * speed
            self._step_through(squares, friction, hottest[block])
        return hottest

    def _squares(self, current: Array, velocity: Array) -> Array:
        """Return the mean squared current of each phase [A^2], shape (phases, intervals, lanes); advance the angles."""
        angles = np.empty((len(velocity) + 1, velocity.shape[1]))
        angles[0] = self._angle
        np.cumsum(velocity * self._electrical_angle_per_speed, axis=0, out=angles[1:])
        angles[1:] += self._angle
        self._angle = np.remainder(angles[-1], 2.0 * np.pi)
        return turning_squares(self._squared_current_factor * current**2, angles[:-1], angles[1:])

    def _step_through(self, squares: Array, friction: Array, hottest: Array) -> None:
        """Step the network through squared currents [A^2] and friction heat [W]; write the hottest phase [degC]."""
        network, interval = self.network, self._interval
        rises = np.empty((len(hottest), *network.rises.shape))
        has_friction = friction.any()
        for k in range(len(hottest)):
            network.step(interval, squares[:, k], friction[k] if has_friction else None)
            rises[k] = network.rises
        np.add(rises.max(axis=1), network.ambient, out=hottest)
