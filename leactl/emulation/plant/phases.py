"""Three phase nodes on one housing, over many lanes at once, and the current that each phase carries.

Phases of capacitance Cw/3 are coupled to the housing by 3 Rwh and to the ambient by 3 Rwa each: their mean is the
winding of the two-node network. A step is exact for constant heat; resistances are extrapolated to its middle.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from leactl.emulation.plant.parameters import ActuatorParameters

Array = NDArray[np.float64]

PHASES = 3
NODES = 3  # winding as a whole, housing, fixture
MOST_TRANSITIONS = 256  # kept, one for each duration of a step
ROUNDING_S = 1e-6  # rounding error of a sum of many steps


def turning_squares(square: Array, start: Array, end: Array) -> Array:
    """Return the mean squared current of each phase [A^2], shape (phases, ...), from the squared q-axis current [A^2].

    The squares are 2/3 i^2 cos^2(theta - k 2 pi/3), i power-invariant, averaged while the electrical angle theta
    changes linearly from start to end [rad]: samples would show a rotor that turns half an electrical turn a step as
    one at rest.
    """
    third = square / 3.0
    amplitude = third * np.sinc((end - start) / math.pi)
    cosine_part, sine_part = amplitude * np.cos(start + end), amplitude * np.sin(start + end)
    sine_part *= 0.5 * math.sqrt(3.0)
    squares = np.empty((PHASES, *np.shape(third)))
    np.add(third, cosine_part, out=squares[0])
    third -= 0.5 * cosine_part
    np.subtract(third, sine_part, out=squares[1])
    np.add(third, sine_part, out=squares[2])
    return squares


def lead_squares(square: Array) -> Array:
    """Return the squared current of each phase [A^2], shape (phases, ...), for direct current through two leads."""
    return np.stack([square, square, np.zeros_like(square)])


class PhaseNetwork:
    """Temperatures of three phases and a housing [degC] in every lane; a lane is an actuator.

    Besides the phases' own decay, the sum of their heat excites three modes of winding, housing and fixture; in a lane
    without a fixture, that node is separate and at ambient. The modes change in the step at whose start air is blocked.
    """

    def __init__(self, actuators: Sequence[ActuatorParameters], ambient: Sequence[float]) -> None:
        thermal, phases = [a.thermal for a in actuators], [a.phases for a in actuators]
        self.time = 0.0
        self.ambient = np.array(ambient, np.float64)
        self._resistance_at_ambient = np.array(
            [a.resistance(t) for a, t in zip(actuators, ambient, strict=True)]
        )  # ohm
        self._resistance_slope = np.array([a.phase_resistance * a.resistance_coefficient for a in actuators])  # ohm/K
        self._winding_ambient = np.array([1.0 / p.winding_ambient_resistance for p in thermal])  # W/K
        self._winding_housing = np.array([1.0 / p.winding_housing_resistance for p in thermal])
        self._housing_ambient = np.array([1.0 / p.housing_ambient_resistance for p in thermal])
        has_fixture = np.array([phase_parameters.fixture_capacitance > 0.0 for phase_parameters in phases])
        self._fixture_conductance = np.where(
            has_fixture, [1.0 / phase_parameters.fixture_resistance for phase_parameters in phases], 0.0
        )
        self._capacitances = np.array(
            [[p.winding_capacitance for p in thermal], [p.housing_capacitance for p in thermal], np.ones(len(thermal))]
        )  # J/K
        self._capacitances[2, has_fixture] = [
            phase_parameters.fixture_capacitance
            for phase_parameters in phases
            if phase_parameters.fixture_capacitance > 0.0
        ]
        self._air_factors = np.array([phase_parameters.blocked_air_factor for phase_parameters in phases])
        self._blocked_from = np.where(
            self._air_factors != 1.0, [phase_parameters.blocked_air_from for phase_parameters in phases], math.inf
        )
        self.rises = np.zeros((PHASES, len(thermal)))  # K, of the phases above ambient
        self._last_change, self._last_duration = np.zeros_like(self.rises), 1.0
        # rows: each phase as if its housing were at ambient; their mean, negative; the modes, in K of the winding
        self._state = np.zeros((PHASES + 1 + NODES, len(thermal)))
        self._excitation = np.empty_like(self._state)
        self._node_shares = np.zeros((NODES, NODES, len(thermal)))
        self._find_modes()

    # ---------------------------------------------------------------- readings

    @property
    def temperatures(self) -> Array:
        """Temperatures of the phases [degC], shape (3, lanes)."""
        return self.ambient + self.rises

    @property
    def hottest(self) -> Array:
        """Temperature of the hottest phase of every lane [degC]."""
        return np.asarray(self.ambient + self.rises.max(axis=0))

    @property
    def winding(self) -> Array:
        """Mean temperature of the phases [degC]."""
        return np.asarray(self.ambient + self.rises.mean(axis=0))

    @property
    def housing(self) -> Array:
        """Temperature of the housing [degC]."""
        return np.asarray(self.ambient + self._node_rises()[1])

    @property
    def fixture(self) -> Array:
        """Temperature of the fixture on the housing [degC]; ambient in a lane without a fixture."""
        return np.asarray(self.ambient + self._node_rises()[2])

    @property
    def resistances(self) -> Array:
        """Phase resistances now [ohm], shape (3, lanes)."""
        return self._resistance_at_ambient + self._resistance_slope * self.rises

    # ---------------------------------------------------------------- time

    def step(self, duration: float, squares: Array, housing_heat: Array | None = None) -> None:
        """Advance by a duration [s] under constant mean squares of the phase currents [A^2] and housing heat [W].

        With current, keep steps short against the phases' time constant (Cw (Rwa || Rwh), the LEA's 6.5 s): the
        error of the resistance grows with the square of the step.
        """
        if self.time >= self._next_blocking - ROUNDING_S:
            self._find_modes()
        decay, gain, housing_gain = self._transitions.get(duration) or self._transition(duration)
        state, excitation = self._state, self._excitation
        mid_step_resistance = self._last_change * (0.5 * duration / self._last_duration)
        mid_step_resistance += self.rises
        mid_step_resistance *= self._resistance_slope
        mid_step_resistance += self._resistance_at_ambient
        np.multiply(mid_step_resistance, squares, out=excitation[:PHASES])
        np.add.reduce(excitation[:PHASES], axis=0, out=excitation[PHASES])
        excitation[PHASES + 1 :] = excitation[PHASES]
        excitation *= gain
        state *= decay
        state += excitation
        if housing_heat is not None:
            state[PHASES + 1 :] += housing_gain * housing_heat
        previous_rises = self.rises
        self.rises = state[:PHASES] + np.add.reduce(state[PHASES:], axis=0)
        np.subtract(self.rises, previous_rises, out=self._last_change)
        self._last_duration = duration
        self.time += duration

    def _node_rises(self) -> Array:
        """Return the rises of winding, housing and fixture above ambient [K], shape (nodes, lanes)."""
        return np.asarray((self._node_shares * self._state[PHASES + 1 :]).sum(axis=1))

    def _find_modes(self) -> None:
        """Compute the modes of the present conductances, and convert the state to them."""
        node_rises = self._node_rises()
        is_blocked = self.time >= self._blocked_from - ROUNDING_S
        self._next_blocking = float(np.min(self._blocked_from, where=~is_blocked, initial=math.inf))
        air_conductance = self._housing_ambient / np.where(is_blocked, self._air_factors, 1.0)
        conductances = np.zeros((len(air_conductance), NODES, NODES))
        conductances[:, 0, 0] = self._winding_ambient + self._winding_housing
        conductances[:, 1, 1] = self._winding_housing + air_conductance + self._fixture_conductance
        conductances[:, 2, 2] = self._fixture_conductance
        conductances[:, 0, 1] = conductances[:, 1, 0] = -self._winding_housing
        conductances[:, 1, 2] = conductances[:, 2, 1] = -self._fixture_conductance
        root_capacitances = np.sqrt(self._capacitances).T
        # C^-1/2 K C^-1/2 is symmetric: real rates, orthogonal modes
        rates, vectors = np.linalg.eigh(conductances / (root_capacitances[:, :, None] * root_capacitances[:, None, :]))
        mode_shapes = (vectors / root_capacitances[:, :, None]).transpose(1, 2, 0)  # node, mode, lane
        phase_rate = (self._winding_ambient + self._winding_housing) / self._capacitances[0]
        self._rates = np.vstack([np.tile(phase_rate, (PHASES + 1, 1)), np.maximum(rates.T, 0.0)])
        phase_gain = PHASES / self._capacitances[0]
        self._gains = np.vstack([np.tile(phase_gain, (PHASES, 1)), -phase_gain / PHASES, mode_shapes[0] ** 2])
        self._housing_gains = mode_shapes[0] * mode_shapes[1]
        # in a lane without a fixture, the mode of the fixture has no share in the winding
        self._node_shares = np.divide(
            mode_shapes, mode_shapes[0], out=np.zeros_like(mode_shapes), where=mode_shapes[0] != 0.0
        )
        mode_amplitudes = np.einsum("nml,nl->ml", mode_shapes, self._capacitances * node_rises)
        self._state[PHASES + 1 :] = mode_shapes[0] * mode_amplitudes
        self._transitions: dict[float, tuple[Array, Array, Array]] = {}

    def _transition(self, duration: float) -> tuple[Array, Array, Array]:
        """Return the decay of the state in a step [s], and its gains from the phases' heat and the housing's [K/W]."""
        decayed_share = -np.expm1(-self._rates * duration)
        integrated_decay = np.divide(
            decayed_share, self._rates, out=np.full_like(decayed_share, duration), where=self._rates > 0.0
        )
        transition = (
            1.0 - decayed_share,
            integrated_decay * self._gains,
            integrated_decay[PHASES + 1 :] * self._housing_gains,
        )
        if len(self._transitions) > MOST_TRANSITIONS:
            self._transitions.clear()
        self._transitions[duration] = transition
        return transition
