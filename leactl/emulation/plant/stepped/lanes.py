"""Lanes of the stepped plant: one bench in one run each, their parameters as arrays, their effects by group.

Lanes that stand side by side with the same kinds of effects form a group; a group's effects act on views of the
plant's arrays, so that nothing is gathered or scattered while it steps.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from leactl.emulation.plant.effects.contract import HOOKS, Now, PlantEffect, own_hooks
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters

Array = NDArray[np.float64]
ROLES = ("test", "load")


@dataclass(frozen=True)
class Lane:
    """One bench at the start of one run."""

    setup: str
    test: ActuatorParameters = field(default_factory=ActuatorParameters)
    load: ActuatorParameters = field(default_factory=ActuatorParameters)
    bench: BenchParameters = field(default_factory=BenchParameters)
    effects: tuple[PlantEffect, ...] = ()
    angle: float = 0.0  # rad, of both rotors
    winding: float | None = None  # degC, of the test actuator; None is the ambient
    housing: float | None = None
    fixture: float | None = None


class Bound(NamedTuple):
    """One effect over the lanes of its group."""

    effect: PlantEffect
    row: int
    lanes: slice
    now: Now

    def of(self, array: Array) -> Array:
        """View of an array over actuators and lanes."""
        view: Array = array[self.row, self.lanes]
        return view

    @property
    def width(self) -> int:
        """How many lanes."""
        return int(self.lanes.stop - self.lanes.start)


def column(lanes: Sequence[Lane], number: Callable[[Lane], float]) -> Array:
    """One number of every lane."""
    return np.array([number(lane) for lane in lanes], np.float64)


def rows(lanes: Sequence[Lane], number: Callable[[ActuatorParameters], float]) -> Array:
    """One number of both actuators of every lane, test above load."""
    return np.array([[number(lane.test) for lane in lanes], [number(lane.load) for lane in lanes]], np.float64)


def bind(lanes: Sequence[Lane]) -> dict[str, list[Bound]]:
    """Every effect over its lanes, by what it does."""
    bound: dict[str, list[Bound]] = {hook: [] for hook in HOOKS}
    first = 0
    for _, members in itertools.groupby(lanes, key=_kinds):
        group = list(members)
        place = slice(first, first + len(group))
        first = place.stop
        for k in range(len(group[0].effects)):
            singles = [lane.effects[k] for lane in group]
            effect = type(singles[0]).stacked(singles)
            own = Bound(effect, ROLES.index(effect.role), place, Now())
            for hook in own_hooks(effect):
                bound[hook].append(own)
    return bound


def _kinds(lane: Lane) -> tuple[tuple[type[PlantEffect], str], ...]:
    return tuple((type(effect), effect.role) for effect in lane.effects)


def in_groups(lanes: Sequence[Lane]) -> list[int]:
    """An order of the lanes that puts those with the same kinds of effects side by side."""
    names = [[f"{kind.__module__}.{role}" for kind, role in _kinds(lane)] for lane in lanes]
    return sorted(range(len(lanes)), key=lambda index: (names[index], index))
