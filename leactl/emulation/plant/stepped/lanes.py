"""Lanes of the stepped plant: each lane is one bench in one run; parameters are arrays over lanes.

Adjacent lanes with the same kinds of effects form a group. The effects of a group act on views of the plant's arrays,
so that nothing is gathered or scattered while the plant steps.
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


class EffectGroup(NamedTuple):
    """One effect, with arrays as its parameters, over the lanes of a group."""

    effect: PlantEffect
    row: int
    lanes: slice
    now: Now

    def view(self, array: Array) -> Array:
        """Return the view of an array over actuators and lanes that holds the effect's actuator and lanes."""
        view: Array = array[self.row, self.lanes]
        return view

    @property
    def width(self) -> int:
        """Number of lanes."""
        return int(self.lanes.stop - self.lanes.start)


def column(lanes: Sequence[Lane], value_of: Callable[[Lane], float]) -> Array:
    """Collect one value of every lane in an array, shape (lanes,)."""
    return np.array([value_of(lane) for lane in lanes], np.float64)


def rows(lanes: Sequence[Lane], value_of: Callable[[ActuatorParameters], float]) -> Array:
    """Collect one value of both actuators of every lane, shape (2, lanes), the test actuator first."""
    return np.array([[value_of(lane.test) for lane in lanes], [value_of(lane.load) for lane in lanes]], np.float64)


def bind(lanes: Sequence[Lane]) -> dict[str, list[EffectGroup]]:
    """Group the lanes' effects; returns for each hook name the effect groups whose effects define that hook."""
    bound: dict[str, list[EffectGroup]] = {hook: [] for hook in HOOKS}
    first = 0
    for _, members in itertools.groupby(lanes, key=_kinds):
        adjacent = list(members)
        span = slice(first, first + len(adjacent))
        first = span.stop
        for k in range(len(adjacent[0].effects)):
            singles = [lane.effects[k] for lane in adjacent]
            effect = type(singles[0]).stacked(singles)
            group = EffectGroup(effect, ROLES.index(effect.role), span, Now())
            for hook in own_hooks(effect):
                bound[hook].append(group)
    return bound


def _kinds(lane: Lane) -> tuple[tuple[type[PlantEffect], str], ...]:
    return tuple((type(effect), effect.role) for effect in lane.effects)


def in_groups(lanes: Sequence[Lane]) -> list[int]:
    """Order the lane indices so that lanes with the same kinds of effects are adjacent."""
    names = [[f"{kind.effect_name()}.{role}" for kind, role in _kinds(lane)] for lane in lanes]
    return sorted(range(len(lanes)), key=lambda index: (names[index], index))
