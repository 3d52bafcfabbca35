"""Exact steps of 31.25 us x 2^level within one regime, with its margins at points within each step."""

import numpy as np
from scipy.linalg import expm

from leactl.emulation.plant.exact.regime import (
    STATES,
    Array,
    Regime,
    RigParameters,
    electric,
    equations,
    net_torque_row,
)

TICK = 0.02 / 640  # s
FINE_LEVEL = 3  # steps to 0.25 ms have margins at every tick; longer ones every 0.25 ms, 11 times a shaft period
TOP_LEVEL = 10  # 32 ms


class Propagator:
    """Transition matrices of one regime, computed when first needed."""

    def __init__(self, plant: RigParameters, regime: Regime) -> None:
        self._generator, self.margins, self.switches = equations(plant, regime)
        self._electric = tuple(electric(plant, regime, k) for k in (0, 1))
        self._plant, self._regime = plant, regime
        self.margin_count = len(self.switches)
        self._transitions: list[Array] = [np.asarray(expm(self._generator * TICK))]
        self._margin_rows: list[Array] = [self.margins @ self._transitions[0]]
        self.steps: list[Array] = [self._stack(0)]
        self.voltage_rows = tuple(row.voltage for row in self._electric)

    def step(self, level: int) -> Array:
        """Return the matrix that gives the state after 2^level ticks, and below it the margins at points on the way."""
        while level >= len(self.steps):
            next_level = len(self.steps)
            transition = self._transitions[-1]
            self._transitions.append(transition @ transition)
            if next_level <= FINE_LEVEL:
                self._margin_rows.append(np.vstack([self._margin_rows[-1], self._margin_rows[-1] @ transition]))
            else:
                first_half = (
                    self.margins @ self._transitions[FINE_LEVEL]
                    if next_level == FINE_LEVEL + 1
                    else self._margin_rows[-1]
                )
                self._margin_rows.append(np.vstack([first_half, first_half @ transition]))
            self.steps.append(self._stack(next_level))
        return self.steps[level]

    def _stack(self, level: int) -> Array:
        """Stack the rows that give the state after 2^level ticks and those that give the margins on the way."""
        return np.ascontiguousarray(np.vstack([self._transitions[level][:STATES], self._margin_rows[level]]))

    def net_torque(self, k: int, point: Array) -> float:
        """Return the torque on a rotor at standstill, without friction [N*m]."""
        return float(net_torque_row(self._plant, self._regime, k) @ point)

    def after(self, point: Array, duration: float) -> Array:
        """Return state and inputs after a duration [s] of at most a tick, by six terms of the Taylor series."""
        advanced = point.copy()
        term = point
        for order in range(1, 7):
            term = self._generator @ term
            term *= duration / order
            advanced += term
        return advanced
