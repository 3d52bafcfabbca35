"""Expand `sweep` and `grid` steps to holds of levels, in an order that separates friction and hysteresis."""

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
    levels: tuple[float, ...], visit: str, overshoot: float, previous_setpoint: float | None
) -> Iterator[tuple[str, float]]:
    """Yield the names ("hold", "turn", "rest") and setpoints of a sweep in order.

    Parameters
    ----------
    visit : order of the levels, as in `SweepStep`.
    overshoot : distance of a turn beyond the levels; 0: no turns.
    previous_setpoint : setpoint before the sweep; None: not known.
    """
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
        if overshoot and (previous_setpoint is None or previous_setpoint >= bottom):
            yield "turn", bottom - overshoot
        yield from (("hold", level) for level in rising)
        if overshoot:
            yield "turn", top + overshoot
        yield from (("hold", level) for level in reversed(rising if overshoot else rising[:-1]))
        if overshoot:
            yield "turn", bottom - overshoot


def sweep(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Write the actions of a `sweep` step; `pass_number` counts the passes of the enclosing repeats."""
    content: SweepStep = step.content
    timeline.check_times(step, ("settle_s", "hold_s"), content.hold_s, content.settle_s)
    spelling = timeline.spelling(step, content.role, content)
    if spelling is None:
        return
    rate = content.value_of(spelling, "rate")
    hold_count = content.repeats * len(content.value_of(spelling, "levels"))
    timeline.check_limits(step, hold_count, hold_count * content.hold_s + (content.repeats - 1) * content.pause_s)
    for number in range(1, content.repeats + 1):
        repeat = (pass_number - 1) * content.repeats + number
        parameters: dict[str, float | str] = {"role": content.role, "repeat": repeat}
        if not _visit_levels(timeline, step, spelling, parameters):
            return
        if content.pause_s and number < content.repeats:
            timeline.approach(step, content.role, 0.0, rate, parameters)
            timeline.hold(step, "pause", (content.pause_s, 0.0), content.role, 0.0, parameters)


def _visit_levels(
    timeline: Timeline, step: ProtocolStep, spelling: Spelling, parameters: dict[str, float | str]
) -> bool:
    """Write one repeat of a sweep; if a ramp would begin at an unknown setpoint, add a fault and return False."""
    content: SweepStep = step.content
    followed = timeline.roles[content.role]
    previous_setpoint = None if followed.setpoint is None else followed.setpoint * content.sign
    visit_order = visits(
        content.value_of(spelling, "levels"),
        content.visit,
        content.value_of(spelling, "overshoot") or 0.0,
        previous_setpoint,
    )
    for name, magnitude in visit_order:
        level = magnitude * content.sign
        if not timeline.approach(step, content.role, level, content.value_of(spelling, "rate"), parameters):
            return False
        if name == "rest":
            timeline.hold(step, name, (content.rest_s, 0.0), content.role, level, parameters)
        elif name == "turn":
            timeline.hold(step, name, (content.turn_s, 0.0), content.role, level, parameters)
        else:
            direction = followed.move_to(level)
            hold_parameters = {spelling.setpoint: level, "direction": direction, **parameters}
            timeline.hold(step, name, (content.hold_s, content.settle_s), content.role, level, hold_parameters)
    return True


class _AxisLevels(NamedTuple):
    """One axis of a grid, in the present mode of its role."""

    role: str
    key: str  # of the setpoint, in the parameters of a hold
    levels: tuple[float, ...]
    rate: float | None  # of a ramp to each level; None: the setpoint jumps


def grid(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Write the actions of a `grid` step; `pass_number` counts the passes of the enclosing repeats.

    Its holds have the setpoint of every axis as a parameter; if two axes have the same unit, the key contains the role.
    """
    content: GridStep = step.content
    timeline.check_times(step, ("settle_s", "hold_s"), content.hold_s, content.settle_s)
    axes = _axes_of(timeline, step)
    if not axes:
        return
    hold_count = content.repeats * math.prod(len(axis.levels) for axis in axes)
    timeline.check_limits(step, hold_count, hold_count * content.hold_s)
    row_key: tuple[int, ...] = ()
    for number in range(1, content.repeats + 1):
        repeat = (pass_number - 1) * content.repeats + number
        for indices in itertools.product(*(range(len(axis.levels)) for axis in axes)):
            row_parameters: dict[str, float | str] = {"role": axes[-1].role, "repeat": repeat}
            if content.rest_s and row_key and row_key != (number, *indices[:-1]):
                _rest_at_zero(timeline, step, axes, row_parameters)
            row_key = number, *indices[:-1]
            point = [axis.levels[index] for axis, index in zip(axes, indices, strict=True)]
            _move_axes(timeline, step, axes, point, row_parameters)
            directions = [timeline.roles[axis.role].move_to(value) for axis, value in zip(axes, point, strict=True)]
            parameters = (
                {axis.key: value for axis, value in zip(axes, point, strict=True)}
                | row_parameters
                | {"direction": directions[-1]}
            )
            setpoints = {axis.role: Constant(value) for axis, value in zip(axes, point, strict=True)}
            timeline.segment(step, "hold", content.hold_s, setpoints, parameters, content.settle_s)


def _axes_of(timeline: Timeline, step: ProtocolStep) -> list[_AxisLevels]:
    """Return the axes with their keys and levels; if one does not fit its role's mode, add faults and return none."""
    grid_axes: tuple[GridAxis, ...] = step.content.axes
    roles = [axis.role for axis in grid_axes]
    if len(set(roles)) < len(roles):
        timeline.add_fault(step, ("axes", len(roles) - 1, "role"), f"{roles[-1]} is an axis already")
        return []
    spelling_of_axes = [
        timeline.spelling(step, axis.role, axis, ("axes", number)) for number, axis in enumerate(grid_axes)
    ]
    spellings = [spelling for spelling in spelling_of_axes if spelling is not None]
    if len(spellings) < len(spelling_of_axes):
        return []
    share_units = len(set(spellings)) < len(spellings)
    axes = []
    for number, (axis, spelling) in enumerate(zip(grid_axes, spellings, strict=True)):
        key = f"{axis.role}_{spelling.setpoint}" if share_units else spelling.setpoint
        rate = axis.value_of(spelling, "rate")
        if rate is not None and timeline.setpoint_before_ramp(step, axis.role, ("axes", number, spelling.rate)) is None:
            return []
        axes.append(_AxisLevels(axis.role, key, axis.value_of(spelling, "levels"), rate))
    return axes


def _rest_at_zero(
    timeline: Timeline, step: ProtocolStep, axes: list[_AxisLevels], parameters: Mapping[str, float | str]
) -> None:
    """Move all axes but angles to zero, and hold them there for `rest_s`."""
    resting = [axis for axis in axes if timeline.roles[axis.role].mode is not Mode.ANGLE]
    _move_axes(timeline, step, resting, [0.0] * len(resting), parameters)
    for axis in resting:
        timeline.roles[axis.role].move_to(0.0)
    setpoints = {axis.role: Constant(0.0) for axis in resting}
    timeline.segment(step, "rest", step.content.rest_s, setpoints, parameters)


def _move_axes(
    timeline: Timeline,
    step: ProtocolStep,
    axes: list[_AxisLevels],
    point: list[float],
    parameters: Mapping[str, float | str],
) -> None:
    """Ramp all axes that have a rate together, none faster than its rate; axes without a rate jump at the hold."""
    ramps: dict[str, tuple[float, float]] = {}
    duration = 0.0
    for axis, value in zip(axes, point, strict=True):
        start = timeline.roles[axis.role].setpoint
        if axis.rate is not None and start is not None and start != value:
            ramps[axis.role] = start, value
            duration = max(duration, abs(value - start) / axis.rate)
    if ramps:
        timeline.segment(
            step, "ramp", duration, {role: Ramp(*ends, duration) for role, ends in ramps.items()}, parameters
        )
        for role, (_before, value) in ramps.items():
            timeline.roles[role].move_to(value)
