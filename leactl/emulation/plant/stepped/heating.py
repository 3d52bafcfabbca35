"""Heated runs of many lanes at once: direct current through two leads, no motion, a sample a second."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from leactl.emulation.plant.stepped.lanes import Array, Lane, bind, column, in_groups
from leactl.emulation.plant.stepped.thermal import ThermalLanes

SAMPLE = 1.0  # s
SUBSTEPS = 5  # of 0.2 s: Heun's error is then below 2e-4 of the winding's 6 s


class HeatedRun(NamedTuple):
    """One heated run, a row a second."""

    current: Array  # A, through two leads
    voltage: Array  # V, between them
    winding: Array  # degC, as the camera has it
    housing: Array


def heat(lanes: Sequence[Lane], currents: Sequence[Array]) -> list[HeatedRun]:
    """Run every lane to the end of its currents."""
    order = in_groups(lanes)
    by_lane = dict(zip(order, _heat([lanes[k] for k in order], [currents[k] for k in order]), strict=True))
    return [by_lane[k] for k in range(len(lanes))]


def _heat(lanes: Sequence[Lane], currents: Sequence[Array]) -> list[HeatedRun]:
    bound = bind(lanes)
    thermal = ThermalLanes(lanes, bound)
    cold = column(lanes, lambda lane: lane.test.phase_resistance)
    coefficient = column(lanes, lambda lane: lane.test.resistance_coefficient)
    reference = column(lanes, lambda lane: lane.test.reference_temperature)
    longest, count = max(len(own) for own in currents), len(lanes)
    program = np.zeros((longest, count))
    for k, own in enumerate(currents):
        program[: len(own), k] = own
    still = np.zeros(count)
    voltage, seen = np.zeros((longest, count)), np.zeros((longest, 2, count))

    def resistance(time: float) -> Array:
        value: Array = cold * (1.0 + coefficient * (thermal.winding - reference))
        for own in bound["resistance_share"]:
            value[own.lanes] *= own.effect.resistance_share(thermal.winding[own.lanes], time)
        return value

    step = SAMPLE / SUBSTEPS
    for row in range(longest):
        current = program[row]
        time = row * SAMPLE
        voltage[row], seen[row] = 2.0 * resistance(time) * current, thermal.camera()
        for part in range(SUBSTEPS):
            now = time + part * step
            # two phases in series take the current
            thermal.step(now, step, 2.0 * resistance(now) * current**2, still, still)
    return [
        HeatedRun(own, voltage[: len(own), k], seen[: len(own), 0, k], seen[: len(own), 1, k])
        for k, own in enumerate(currents)
    ]
