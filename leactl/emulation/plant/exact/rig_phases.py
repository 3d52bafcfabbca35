"""The phases of the rig's two actuators: gather the heat of the rig's steps, and step the network of the phases.

The drive voltages use the mean of the three phase resistances, at most 10 ms late; the ripple that unequal phases
cause at twice the electrical frequency is left out.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from leactl.emulation.plant.exact.regime import ANGLE, CURRENT, PER_ACTUATOR, Array
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters, PhaseParameters
from leactl.emulation.plant.phases import PhaseNetwork, lead_squares, turning_squares
from leactl.emulation.plant.thermal import ExactThermalNetwork
from leactl.errors import InputError

LONGEST_GATHERING_S = 0.01  # of heat, before it is applied: 45 A at rest warm a phase by 0.5 K in this time
LEAST_STEP_S = 1e-9  # rounding error of the requested times; a shorter step is left out
PHASES_OF_PART = {"active": slice(0, 2), "inactive": slice(2, 3)}  # phases that two leads feed, and the other one
LONGEST_STEP_S = 0.05  # under direct current: 1/130 of a phase's time constant


def refuse_unused_phase_settings(bench: BenchParameters, *pair: ActuatorParameters) -> None:
    """Raise InputError if an actuator has settings of its phases although the bench does not resolve phases."""
    if not bench.phase_resolved and any(actuator.phases != PhaseParameters() for actuator in pair):
        raise InputError("phases: these act only where the bench has phase_resolved: true; set it or leave them out")


class HottestPhase(NamedTuple):
    """Temperature of the hottest of an actuator's three phases."""

    present: float  # degC
    highest: float  # degC, since the rig was made


class HeatedActuator(Protocol):
    """The parameters and thermal nodes of an actuator that its phases use."""

    parameters: ActuatorParameters
    thermal: ExactThermalNetwork


class RigPhases:
    """Test and load actuator as two lanes of one network of phases, whose means are copied to their thermal nodes."""

    def __init__(self, pair: Sequence[HeatedActuator], ambient: float) -> None:
        actuators = [actuator.parameters for actuator in pair]
        self.network = PhaseNetwork(actuators, [ambient] * len(pair))
        self._thermal_nodes = [actuator.thermal for actuator in pair]
        self._highest = np.full(len(pair), ambient)
        self._phases: list[list[float]] = self.network.temperatures.T.tolist()  # degC, of each actuator
        self._pole_pairs = np.array([float(p.pole_pairs) for p in actuators])
        self._commutation_offsets = np.array([p.phases.commutation_offset for p in actuators])  # rad
        self._durations: list[float] = []  # s, of each step
        self._ends: list[list[tuple[float, ...]]] = []  # currents and angles of both at either end of each step
        self._gathered = 0.0  # s

    @property
    def lead_resistance(self) -> float:
        """Return the resistance of two phases of the test actuator in series [ohm]."""
        return float(self.network.resistances[:2, 0].sum())

    def hottest(self, index: int) -> HottestPhase:
        """Return the present and the highest temperature of the hottest phase of one actuator."""
        return HottestPhase(float(self.network.hottest[index]), float(self._highest[index]))

    def part_temperature(self, index: int, part: str) -> float:
        """Return the mean temperature [degC] of one part, by `PHASES_OF_PART`, of an actuator's winding."""
        phases = self._phases[index][PHASES_OF_PART[part]]
        return sum(phases) / len(phases)

    def gather_step(self, step: float, before: Array, after: Array, friction: list[float]) -> None:
        """Gather the heat of a step [s] between two states of the rig, and apply it when due.

        Parameters
        ----------
        friction : heat of each actuator [J] since heat was last applied; reset to zero when it is applied.
        """
        self._durations.append(step)
        self._ends.append([_currents_and_angles(before), _currents_and_angles(after)])
        self._gathered += step
        if self._gathered > LONGEST_GATHERING_S - LEAST_STEP_S:
            self.apply_gathered_heat(friction)

    def apply_gathered_heat(self, friction: list[float]) -> None:
        """Apply the gathered heat to the network, and reset the friction heat to zero."""
        if self._gathered < LEAST_STEP_S:
            return
        durations = np.array(self._durations)
        ends = np.array(self._ends)  # shape (steps, 2 ends, 2 currents and 2 angles)
        total = float(durations.sum())
        squares = (ends[:, :, :2] ** 2).mean(axis=1)
        angles = ends[:, :, 2:] * self._pole_pairs + self._commutation_offsets
        phase_squares = turning_squares(squares, angles[:, 0], angles[:, 1])
        # s: step, p: phase, l: lane
        means = np.einsum("s,psl->pl", durations, phase_squares) / total
        self._step(round(total, 9), means, np.array(friction) / total)
        self._update_thermal_nodes()
        friction[:] = [0.0] * len(friction)
        self._durations, self._ends, self._gathered = [], [], 0.0

    def heat_leads(self, duration: float, current: float) -> None:
        """Advance by a duration [s] with direct current through two leads of the test actuator [A].

        Heat that is still gathered has to be applied before.
        """
        if duration < LEAST_STEP_S:
            return
        squares = lead_squares(np.array([current**2, 0.0]))
        steps = int(np.ceil(duration / LONGEST_STEP_S))
        for _ in range(steps):
            self._step(round(duration / steps, 9), squares, None)
        self._update_thermal_nodes()

    def _step(self, duration: float, squares: Array, housing_heat: Array | None) -> None:
        self.network.step(duration, squares, housing_heat)
        np.maximum(self._highest, self.network.hottest, out=self._highest)

    def _update_thermal_nodes(self) -> None:
        self._phases = self.network.temperatures.T.tolist()
        means = zip(self._thermal_nodes, self.network.winding.tolist(), self.network.housing.tolist(), strict=True)
        for nodes, winding, housing in means:
            nodes.winding, nodes.housing = winding, housing


def _currents_and_angles(state: Array) -> tuple[float, ...]:
    """Return the currents of test and load actuator, then their angles."""
    item = state.item
    return item(CURRENT), item(PER_ACTUATOR + CURRENT), item(ANGLE), item(PER_ACTUATOR + ANGLE)
