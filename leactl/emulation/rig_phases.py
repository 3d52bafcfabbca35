"""The phases of the rig's two actuators: collects what the rig's steps leave in them, and steps their network.

Voltages see the mean of the three resistances; the ripple at twice the electrical frequency that unequal phases make
is left out.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from leactl.emulation.parameters import ActuatorParameters, BenchParameters, PhaseParameters
from leactl.emulation.phases import PhaseNetwork, lead_squares, turning_squares
from leactl.emulation.regime import ANGLE, CURRENT, PER_ACTUATOR, Array
from leactl.errors import InputError

HELD_S = 0.01  # heat is gathered this long at least while no reading is due: 45 A at rest warm a phase by 0.5 K
LONGEST_S = 0.05  # of a step under direct current, 1/130 of a phase's time constant


def refuse_idle_settings(bench: BenchParameters, *pair: ActuatorParameters) -> None:
    """Raise InputError where an actuator has settings of its phases and the bench does not resolve them."""
    if not bench.phase_resolved and any(actuator.phases != PhaseParameters() for actuator in pair):
        raise InputError("phases: these act only where the bench has phase_resolved: true; set it or leave them out")


class HottestPhase(NamedTuple):
    """Hottest of an actuator's three phases."""

    now: float  # degC
    highest: float  # degC, since the rig was made


class RigPhases:
    """Test and load actuator as two lanes of one network."""

    def __init__(self, pair: Sequence[ActuatorParameters], ambient: float) -> None:
        self.network = PhaseNetwork(pair, [ambient] * len(pair))
        self._highest = np.full(len(pair), ambient)
        self._turns = np.array([float(p.pole_pairs) for p in pair])
        self._offsets = np.array([p.phases.commutation_offset for p in pair])
        self._steps: list[float] = []
        self._ends: list[list[tuple[float, ...]]] = []  # currents and angles of both at either end of each step
        self._gathered = 0.0

    @property
    def lead_resistance(self) -> float:
        """Two phases of the test actuator in series [ohm]."""
        return float(self.network.resistances[:2, 0].sum())

    def hottest(self, place: int) -> HottestPhase:
        """Hottest phase of one actuator, now and at its highest."""
        return HottestPhase(float(self.network.hottest[place]), float(self._highest[place]))

    def means(self) -> list[tuple[float, float]]:
        """Mean of the phases and housing of each actuator [degC]."""
        network = self.network
        return list(zip(network.winding.tolist(), network.housing.tolist(), strict=True))

    def take(self, step: float, before: Array, after: Array, friction: list[float]) -> None:
        """Take one step of the rig [s] between two states, and the friction heat [J] of all steps since it was zero."""
        self._steps.append(step)
        self._ends.append([_ends(before), _ends(after)])
        self._gathered += step
        if self._gathered >= HELD_S:
            self.hold(friction)

    def hold(self, friction: list[float]) -> None:
        """Let what was gathered act, and set the friction heat back to zero."""
        if not self._steps:
            return
        lengths, ends = np.array(self._steps), np.array(self._ends)  # step, end, current and angle of each
        total = float(lengths.sum())
        squares = (ends[:, :, :2] ** 2).mean(axis=1)
        angles = ends[:, :, 2:] * self._turns + self._offsets
        each = turning_squares(squares, angles[:, 0], angles[:, 1])
        means = np.einsum("s,psl->pl", lengths, each) / total
        self._step(round(total, 9), means, np.array(friction) / total)
        friction[:] = [0.0] * len(friction)
        self._steps, self._ends, self._gathered = [], [], 0.0

    def heat_leads(self, duration: float, current: float) -> None:
        """Go on by a duration [s] with direct current through two leads of the test actuator [A]."""
        squares = lead_squares(np.array([current**2, 0.0]))
        steps = int(np.ceil(duration / LONGEST_S))
        for _ in range(steps):
            self._step(round(duration / steps, 9), squares, None)

    def _step(self, duration: float, squares: Array, housing_heat: Array | None) -> None:
        self.network.step(duration, squares, housing_heat)
        np.maximum(self._highest, self.network.hottest, out=self._highest)


def _ends(state: Array) -> tuple[float, ...]:
    item = state.item
    return item(CURRENT), item(PER_ACTUATOR + CURRENT), item(ANGLE), item(PER_ACTUATOR + ANGLE)
