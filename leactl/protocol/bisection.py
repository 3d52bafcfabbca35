"""Expand `bisect` steps to trials at setpoints between two ends; the number of trials is fixed in advance.

The first two trials are at the ends. The others are between them, at setpoints chosen during the run, and are skipped
if both ends have the same outcome. The setpoint rests at zero after every trial.
"""

from leactl.driver.contract import Mode
from leactl.protocol.criteria import criterion
from leactl.protocol.plan import (
    BISECTING,
    SETPOINT_QUANTITY,
    Constant,
    EndWhen,
    Search,
    SearchTrial,
    SoughtSetpoint,
    StepOutcome,
    When,
)
from leactl.protocol.setpointkeys import CURRENT, SPELLINGS
from leactl.protocol.steps import BisectStep, ProtocolStep
from leactl.protocol.timeline import Timeline

MAX_HALVINGS = 32  # more would be finer than a drive's setpoint, which has at most 32 bits


def bisect(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Write the actions of a `bisect` step; `pass_number` counts the passes of the enclosing repeats."""
    content: BisectStep = step.content
    times = content.hold_s, content.settle_s
    timeline.check_times(step, ("settle_s", "hold_s"), *times)
    trial_criterion = criterion(timeline, step, ("criterion", "hold_s"), times)
    mode = timeline.roles[content.role].mode
    search = Search(
        content.name,
        content.role,
        SETPOINT_QUANTITY[Mode.CURRENT],
        content.from_current_A,
        content.to_current_A,
        content.resolution_A,
        content.otherwise == "fail",
    )
    if timeline.modes_known and SPELLINGS.get(mode) is not CURRENT:
        message = f"{content.role} is {'off' if mode is Mode.OFF else f'in {mode} mode'} at this point"
        timeline.add_fault(step, "role", f"{message}; current or torque_profile was expected")
        return
    if not _is_valid(timeline, step, search):
        return
    rest_s = max(content.rest_s, 1.0 / timeline.rate_hz)
    timeline.check_limits(step, 2 * search.trials, search.trials * (content.hold_s + rest_s))
    parameters: dict[str, float | str] = {"role": content.role, "repeat": pass_number}
    ends = search.first, search.second
    sought_setpoint = SoughtSetpoint(min(ends), max(ends))
    for number in range(1, search.trials + 1):
        if number == len(ends) + 1:
            timeline.add(step, When(StepOutcome(search.name, BISECTING)))
        profile = sought_setpoint if number > len(ends) else Constant(ends[number - 1])
        timeline.segment(
            step,
            content.name,
            content.hold_s,
            {content.role: profile},
            {**parameters, "trial": number},
            content.settle_s,
            trial_criterion,
            SearchTrial(search, number),
        )
        timeline.hold(step, "rest", (rest_s, 0.0), content.role, 0.0, parameters)
    timeline.add(step, EndWhen())


def _is_valid(timeline: Timeline, step: ProtocolStep, search: Search) -> bool:
    """Return whether the ends and the resolution of a search are valid; if not, add a fault to the timeline."""
    span = abs(search.second - search.first)
    if not span > 0.0:
        timeline.add_fault(step, "to_current_A", f"{search.second:g} A: another end than from_current_A was expected")
    elif search.resolution >= span:
        message = f"{search.resolution:g} A: less than the {span:g} A between the ends was expected"
        timeline.add_fault(step, "resolution_A", message)
    elif span / search.resolution > 2.0**MAX_HALVINGS or search.halvings > MAX_HALVINGS:
        message = f"{search.resolution:g} A: at least {span / 2.0**MAX_HALVINGS:.3g} A was expected"
        timeline.add_fault(step, "resolution_A", message)
    else:
        return True
    return False
