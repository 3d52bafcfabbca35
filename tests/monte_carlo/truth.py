"""True temperatures of many runs at once: their currents and speeds through the emulation's phase-resolved lanes."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from leactl.emulation.plant.phase_lanes import PhaseLane, PhaseLanes
from leactl.safety.thermal.box import Array
from tests.monte_carlo.plants import ROLES, Truth
from tests.monte_carlo.rotors import TICK_S
from tests.monte_carlo.supervised import Course

BLOCK = 2048  # ticks that are heated at once


class History(NamedTuple):
    """What happened to one bench, one after the other: runs, and seconds at rest between them."""

    truth: Truth
    parts: Sequence[Course | float]


def hottest(histories: Sequence[History]) -> list[tuple[float, float]]:
    """Of each history the hottest phase of either actuator [degC]: throughout, and within its last part."""
    if not histories:
        return []
    lanes, columns, lengths, lasts = [], [], [], []
    for truth, parts in histories:
        for place, role in enumerate(ROLES):
            actuator = truth.actuators[role]
            lanes.append(PhaseLane(actuator, truth.ambient, angle=truth.angle))
            columns.append([_column(part, place) for part in parts])
        lengths.append(sum(len(current) for current, _ in columns[-1]))
        lasts.append(lengths[-1] - len(columns[-1][-1][0]))
    plant = PhaseLanes(lanes, TICK_S)
    begins = np.repeat(lasts, len(ROLES))
    whole, own = np.full(len(lanes), -np.inf), np.full(len(lanes), -np.inf)
    joined = [[np.concatenate(each) for each in zip(*column, strict=True)] for column in columns]
    for first in range(0, max(lengths), BLOCK):
        count = min(BLOCK, max(lengths) - first)
        currents, speeds = np.zeros((count, len(lanes))), np.zeros((count, len(lanes)))
        for lane, (current, speed) in enumerate(joined):
            piece = current[first : first + count]
            currents[: len(piece), lane] = piece
            speeds[: len(piece), lane] = speed[first : first + count]
        result = plant.run(currents, speeds)
        whole = np.maximum(whole, result.max(axis=0))
        late = np.arange(first, first + count)[:, None] >= begins
        own = np.maximum(own, np.where(late, result, -np.inf).max(axis=0))
    pairs = np.stack([whole, own], axis=1).reshape(len(histories), len(ROLES), 2).max(axis=1)
    return [(float(a), float(b)) for a, b in pairs]


def _column(part: Course | float, place: int) -> tuple[Array, Array]:
    """True current and speed of one actuator, tick by tick."""
    if isinstance(part, float):
        nothing = np.zeros(round(part / TICK_S))
        return nothing, nothing
    turns = place == 0 or part.coupled
    return part.currents[place], part.velocity if turns else np.zeros_like(part.velocity)
