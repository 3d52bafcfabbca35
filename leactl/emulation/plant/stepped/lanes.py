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
    housing: float | None = None  # degC, likewise
    fixture: float | None = None  # degC, likewise


class EffectGroup(NamedTuple):
    """One effect, with arrays as its parameters, over the lanes of a group."""

    effect: PlantEffect
    row: int  # of the actuator: 0 test, 1 load
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
    """Group the effects of adjacent lanes; return, for each hook, the groups whose effect defines that hook."""
    groups_by_hook: dict[str, list[EffectGroup]] = {hook: [] for hook in HOOKS}
    first_lane = 0
    for _, group_members in itertools.groupby(lanes, key=_kinds):
        group_lanes = list(group_members)
        lane_slice = slice(first_lane, first_lane + len(group_lanes))
        first_lane = lane_slice.stop
        for k in range(len(group_lanes[0].effects)):
            lane_effects = [lane.effects[k] for lane in group_lanes]
            effect = type(lane_effects[0]).stacked(lane_effects)
            group = EffectGroup(effect, ROLES.index(effect.role), lane_slice, Now())
            for hook in own_hooks(effect):
                groups_by_hook[hook].append(group)
    return groups_by_hook


def _kinds(lane: Lane) -> tuple[tuple[type[PlantEffect], str], ...]:
    """Return class and role of each effect of a lane."""
    return tuple((type(effect), effect.role) for effect in lane.effects)


def in_groups(lanes: Sequence[Lane]) -> list[int]:
    """Return the indices of the lanes in an order in which lanes with the same kinds of effects are adjacent."""
    effect_names = [[f"{kind.effect_name()}.{role}" for kind, role in _kinds(lane)] for lane in lanes]
    return sorted(range(len(lanes)), key=lambda index: (effect_names[index], index))
