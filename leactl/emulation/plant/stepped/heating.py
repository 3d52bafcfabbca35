"""Heated runs of many lanes at once: direct current through two leads, no motion, one sample a second."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from leactl.emulation.plant.stepped.lanes import Array, Lane, bind, column, in_groups
from leactl.emulation.plant.stepped.thermal import ThermalLanes

SAMPLE_S = 1.0  # between two samples
SUBSTEPS = 5  # of 0.2 s each: the error of Heun's rule is then below 2e-4 for the winding's time constant of 6 s


class HeatedRun(NamedTuple):
    """Signals of one heated run, one value a second."""

    current: Array  # A, through two leads
    voltage: Array  # V, between these leads
    winding: Array  # degC, as the camera reads it
    housing: Array  # degC, likewise


def heat(lanes: Sequence[Lane], currents: Sequence[Array]) -> list[HeatedRun]:
    """Heat each lane with its currents through two leads [A], one a second; results are in the order of `lanes`."""
    grouped_lanes = in_groups(lanes)
    run_by_lane = dict(
        zip(grouped_lanes, _heat([lanes[k] for k in grouped_lanes], [currents[k] for k in grouped_lanes]), strict=True)
    )
    return [run_by_lane[k] for k in range(len(lanes))]


def _heat(lanes: Sequence[Lane], currents: Sequence[Array]) -> list[HeatedRun]:
    """Heat lanes of which those with the same kinds of effects are adjacent."""
    bound = bind(lanes)
    thermal = ThermalLanes(lanes, bound)
    reference_resistance = column(lanes, lambda lane: lane.test.phase_resistance)
    coefficient = column(lanes, lambda lane: lane.test.resistance_coefficient)
    reference = column(lanes, lambda lane: lane.test.reference_temperature)
    most_rows, lane_count = max(len(line_current) for line_current in currents), len(lanes)
    program = np.zeros((most_rows, lane_count))
    for k, line_current in enumerate(currents):
        program[: len(line_current), k] = line_current
    standstill = np.zeros(lane_count)
    voltage, camera = np.zeros((most_rows, lane_count)), np.zeros((most_rows, 2, lane_count))

    def resistance(time: float) -> Array:
        """Return the phase resistance of every lane [ohm] at a time [s]."""
        resistances: Array = reference_resistance * (1.0 + coefficient * (thermal.winding - reference))
        for group in bound["resistance_share"]:
            resistances[group.lanes] *= group.effect.resistance_share(thermal.winding[group.lanes], time)
        return resistances

    step = SAMPLE_S / SUBSTEPS
    for row in range(most_rows):
        current = program[row]
        time = row * SAMPLE_S
        voltage[row], camera[row] = 2.0 * resistance(time) * current, thermal.camera()
        for substep in range(SUBSTEPS):
            substep_time = time + substep * step
            # two phases in series take the current
            thermal.step(substep_time, step, 2.0 * resistance(substep_time) * current**2, standstill, standstill)
    return [
        HeatedRun(
            line_current,
            voltage[: len(line_current), k],
            camera[: len(line_current), 0, k],
            camera[: len(line_current), 1, k],
        )
        for k, line_current in enumerate(currents)
    ]
