"""Heated runs of many lanes at once: direct current through two leads, no motion, one sample a second."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from leactl.emulation.plant.stepped.lanes import Array, Lane, bind, column, in_groups
from leactl.emulation.plant.stepped.thermal import ThermalLanes

SAMPLE_S = 1.0
SUBSTEPS = 5  # of 0.2 s: Heun's error is then below 2e-4 of the winding's 6 s


class HeatedRun(NamedTuple):
    """Signals of one heated run, one row a second."""

    current: Array  # A, through two leads
    voltage: Array  # V, between them
    winding: Array  # degC, as the camera reads it
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
    longest, count = max(len(line_current) for line_current in currents), len(lanes)
    program = np.zeros((longest, count))
    for k, line_current in enumerate(currents):
        program[: len(line_current), k] = line_current
    still = np.zeros(count)
    voltage, camera = np.zeros((longest, count)), np.zeros((longest, 2, count))

    def resistance(time: float) -> Array:
        value: Array = cold * (1.0 + coefficient * (thermal.winding - reference))
        for group in bound["resistance_share"]:
            value[group.lanes] *= group.effect.resistance_share(thermal.winding[group.lanes], time)
        return value

    step = SAMPLE_S / SUBSTEPS
    for row in range(longest):
        current = program[row]
        time = row * SAMPLE_S
        voltage[row], camera[row] = 2.0 * resistance(time) * current, thermal.camera()
        for part in range(SUBSTEPS):
            now = time + part * step
            # two phases in series take the current
            thermal.step(now, step, 2.0 * resistance(now) * current**2, still, still)
    return [
        HeatedRun(
            line_current,
            voltage[: len(line_current), k],
            camera[: len(line_current), 0, k],
            camera[: len(line_current), 1, k],
        )
        for k, line_current in enumerate(currents)
    ]
