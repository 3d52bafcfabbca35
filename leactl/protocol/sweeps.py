"""Sweeps and grids: hold levels in an order that separates friction and hysteresis."""

import itertools
import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from leactl.driver.contract import Mode
from leactl.protocol.plan import Constant, Ramp
from leactl.protocol.setpointkeys import Spelling
from leactl.protocol.steps import GridAxis, GridStep, ProtocolStep, SweepStep
from leactl.protocol.timeline import Timeline


def visits(
    levels: tuple[float, ...], visit: str, overshoot: float, before: float | None
) -> Iterator[tuple[str, float]]:
    """Names ("hold", "turn", "rest") and setpoints in order; `before` is the setpoint before the sweep."""
    rising = sorted(levels)
    if visit == "as_given":
        yield from (("hold", level) for level in levels)
    elif visit == "up":
        yield from (("hold", level) for level in rising)
    elif visit == "down":
        yield from (("hold", level) for level in reversed(rising))
    elif visit == "around":
        for level in rising:
            yield from (("turn", level - overshoot), ("hold", level), ("turn", level + overshoot), ("hold", level))
            yield "rest", 0.0
    else:
        bottom, top = rising[0], rising[-1]
        if overshoot and (before is None or before >= bottom):
            yield "turn", bottom - overshoot
        yield from (("hold", level) for level in rising)
        if overshoot:
            yield "turn", top + overshoot
        yield from (("hold", level) for level in reversed(rising if overshoot else rising[:-1]))
        if overshoot:
            yield "turn", bottom - overshoot


def sweep(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Expand a sweep; `pass_number` counts the passes of the enclosing repeats."""
    content: SweepStep = step.content
    timeline.check_times(step, ("settle_s", "hold_s"), content.hold_s, content.settle_s)
    spelling = timeline.spelling(step, content.role, content)
    if spelling is None:
        return
    rate = content.given(spelling, "rate")
    holds = content.repeats * len(content.given(spelling, "levels"))
    timeline.foresee(step, holds, holds * content.hold_s + (content.repeats - 1) * content.pause_s)
    for number in range(1, content.repeats + 1):
        repeat = (pass_number - 1) * content.repeats + number
        where: dict[str, float | str] = {"role": content.role, "repeat": repeat}
        if not _visit_levels(timeline, step, spelling, where):
            return
        if content.pause_s and number < content.repeats:
            timeline.approach(step, content.role, 0.0, rate, where)
            timeline.hold(step, "pause", (content.pause_s, 0.0), content.role, 0.0, where)


def _visit_levels(timeline: Timeline, step: ProtocolStep, spelling: Spelling, where: dict[str, float | str]) -> bool:
    content: SweepStep = step.content
    followed = timeline.roles[content.role]
    before = None if followed.setpoint is None else followed.setpoint * content.sign
    order = visits(
        content.given(spelling, "levels"), content.visit, content.given(spelling, "overshoot") or 0.0, before
    )
    for name, magnitude in order:
        level = magnitude * content.sign
        if not timeline.approach(step, content.role, level, content.given(spelling, "rate"), where):
            return False
        if name == "rest":
            timeline.hold(step, name, (content.rest_s, 0.0), content.role, level, where)
        elif name == "turn":
            timeline.hold(step, name, (content.turn_s, 0.0), content.role, level, where)
        else:
            direction = followed.goes_to(level)
            parameters = {spelling.setpoint: level, "direction": direction, **where}
            timeline.hold(step, name, (content.hold_s, content.settle_s), content.role, level, parameters)
    return True


class _Lane(NamedTuple):
    """One axis of a grid, with the setpoint key of its role's present mode."""

    role: str
    key: str
    levels: tuple[float, ...]
    rate: float | None


def grid(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Expand a grid; its holds have every axis's setpoint as parameter, with the role in the key if units are equal."""
    content: GridStep = step.content
    timeline.check_times(step, ("settle_s", "hold_s"), content.hold_s, content.settle_s)
    lanes = _lanes(timeline, step)
    if not lanes:
        return
    holds = content.repeats * math.prod(len(lane.levels) for lane in lanes)
    timeline.foresee(step, holds, holds * content.hold_s)
    row: tuple[int, ...] = ()
    for number in range(1, content.repeats + 1):
        repeat = (pass_number - 1) * content.repeats + number
        for indices in itertools.product(*(range(len(lane.levels)) for lane in lanes)):
            where: dict[str, float | str] = {"role": lanes[-1].role, "repeat": repeat}
            if content.rest_s and row and row != (number, *indices[:-1]):
                _rest(timeline, step, lanes, where)
            row = number, *indices[:-1]
            point = [lane.levels[index] for lane, index in zip(lanes, indices, strict=True)]
            _move(timeline, step, lanes, point, where)
            directions = [timeline.roles[lane.role].goes_to(value) for lane, value in zip(lanes, point, strict=True)]
            parameters = (
                {lane.key: value for lane, value in zip(lanes, point, strict=True)}
                | where
                | {"direction": directions[-1]}
            )
            setpoints = {lane.role: Constant(value) for lane, value in zip(lanes, point, strict=True)}
            timeline.segment(step, "hold", content.hold_s, setpoints, parameters, content.settle_s)


def _lanes(timeline: Timeline, step: ProtocolStep) -> list[_Lane]:
    """The axes with their keys and levels; empty, with faults, if an axis does not fit the mode of its role."""
    axes: tuple[GridAxis, ...] = step.content.axes
    roles = [axis.role for axis in axes]
    if len(set(roles)) < len(roles):
        timeline.complain(step, ("axes", len(roles) - 1, "role"), f"{roles[-1]} is an axis already")
        return []
    spelling_of_axes = [timeline.spelling(step, axis.role, axis, ("axes", number)) for number, axis in enumerate(axes)]
    spellings = [spelling for spelling in spelling_of_axes if spelling is not None]
    if len(spellings) < len(spelling_of_axes):
        return []
    shared = len(set(spellings)) < len(spellings)
    lanes = []
    for number, (axis, spelling) in enumerate(zip(axes, spellings, strict=True)):
        key = f"{axis.role}_{spelling.setpoint}" if shared else spelling.setpoint
        rate = axis.given(spelling, "rate")
        if rate is not None and timeline.known_setpoint(step, axis.role, ("axes", number, spelling.rate)) is None:
            return []
        lanes.append(_Lane(axis.role, key, axis.given(spelling, "levels"), rate))
    return lanes


def _rest(timeline: Timeline, step: ProtocolStep, lanes: list[_Lane], where: Mapping[str, float | str]) -> None:
    resting = [lane for lane in lanes if timeline.roles[lane.role].mode is not Mode.ANGLE]
    _move(timeline, step, resting, [0.0] * len(resting), where)
    for lane in resting:
        timeline.roles[lane.role].goes_to(0.0)
    setpoints = {lane.role: Constant(0.0) for lane in resting}
    timeline.segment(step, "rest", step.content.rest_s, setpoints, where)


def _move(
    timeline: Timeline, step: ProtocolStep, lanes: list[_Lane], point: list[float], where: Mapping[str, float | str]
) -> None:
    """Ramp all axes with a rate at the same time, none faster than its rate; the others jump at the hold."""
    ramps: dict[str, tuple[float, float]] = {}
    duration = 0.0
    for lane, value in zip(lanes, point, strict=True):
        before = timeline.roles[lane.role].setpoint
        if lane.rate is not None and before is not None and before != value:
            ramps[lane.role] = before, value
            duration = max(duration, abs(value - before) / lane.rate)
    if ramps:
        timeline.segment(step, "ramp", duration, {role: Ramp(*ends, duration) for role, ends in ramps.items()}, where)
        for role, (_before, value) in ramps.items():
            timeline.roles[role].goes_to(value)
