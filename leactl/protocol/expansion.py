"""Expand steps to actions: walk the steps in order, track mode and setpoint of each role, and write the timeline."""

import math
from collections.abc import Callable
from typing import Any

from leactl.driver.contract import Mode
from leactl.errors import InputError
from leactl.protocol import dead_weights, sweeps, trajectory
from leactl.protocol.bisection import bisect
from leactl.protocol.criteria import bounds, criterion
from leactl.protocol.plan import (
    EndWhen,
    InRange,
    Prompt,
    Samples,
    SetRecordRate,
    SetSupply,
    StepOutcome,
    Tare,
    WaitUntil,
    When,
)
from leactl.protocol.schema import divides
from leactl.protocol.setpointkeys import Spelling
from leactl.protocol.signals import CsvSignal, ProtocolSignal
from leactl.protocol.steps import HoldStep, ProtocolStep, RampStep, SetStep, WaitStep, WhenStep
from leactl.protocol.timeline import Timeline

HEATED = "heated"


def expand(timeline: Timeline, steps: tuple[ProtocolStep, ...], pass_number: int = 1) -> None:
    """Write the actions of the steps to the timeline, and add their faults to it.

    `pass_number` counts the passes of all enclosing repeats and becomes the parameter `repeat` of the holds.

    Raises
    ------
    InputError : the plan exceeds the limits of actions, duration or samples.
    """
    for step in steps:
        if step.kind == "repeat":
            times = step.content.times if step.content is not None else 1
            timeline.check_limits(step, times * len(step.inner))
            for number in range(1, times + 1):
                timeline.count_towards_limits(step)
                expand(timeline, step.inner, (pass_number - 1) * times + number)
        elif step.kind == "when":
            _when(timeline, step, pass_number)
        elif step.content is None:
            timeline.count_towards_limits(step)
            timeline.fault_free = False
            timeline.modes_known = timeline.modes_known and step.kind != "mode"
        else:
            _WRITERS[step.kind](timeline, step, pass_number)


def _when(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Write conditional steps; it is a fault if modes or setpoints after them differ from those before."""
    condition = None if step.content is None else _condition(timeline, step)
    states_before = {
        role: (role_setpoint.mode, role_setpoint.setpoint) for role, role_setpoint in timeline.roles.items()
    }
    first_index = len(timeline.actions)
    if condition is not None:
        timeline.add(step, When(condition))
    expand(timeline, step.inner, pass_number)
    if condition is not None:
        timeline.add(step, EndWhen())
    timeline.fault_free = timeline.fault_free and condition is not None
    if any(isinstance(action, SetRecordRate | SetSupply) for action in timeline.actions[first_index:]):
        timeline.add_fault(step, "steps", "a record or supply step would outlast the condition; none was expected")
    for role, (mode, setpoint) in states_before.items() if timeline.fault_free else ():
        role_setpoint = timeline.roles[role]
        if (role_setpoint.mode, role_setpoint.setpoint) != (mode, setpoint):
            expected_state = (
                "off" if mode is Mode.OFF else f"{mode} at {'its angle' if setpoint is None else f'{setpoint:g}'}"
            )
            message = (
                f"{role} is not left as it was; {expected_state}, as before the condition, was expected at the end"
            )
            timeline.add_fault(step, "steps", message)


def _condition(timeline: Timeline, step: ProtocolStep) -> StepOutcome | InRange | None:
    """Return the condition of a `when` step; if it is invalid, add faults and return None."""
    content: WhenStep = step.content
    possible_keys = ("quantity", "role", "below", "above", "unit")
    reading_keys = [key for key in possible_keys if getattr(content, key) is not None]
    if content.step is None and content.outcome is None:
        missing_keys = [key for key in ("quantity", "role", "unit") if key not in reading_keys]
        if missing_keys:
            timeline.add_fault(step, missing_keys[0], "is required and missing; or step and outcome of an earlier step")
            return None
        return InRange(content.quantity or "", content.role or "", *bounds(timeline, step, content))
    if reading_keys:
        timeline.add_fault(step, reading_keys[0], "either step and outcome, or a reading with its bounds, was expected")
        return None
    if content.step is None or content.outcome is None:
        timeline.add_fault(step, "step" if content.step is None else "outcome", "is required and missing")
        return None
    outcomes = timeline.outcomes
    if content.step not in outcomes:
        expected = f"one of {', '.join(outcomes)}" if outcomes else "a bisect, or a hold with until, before it"
        timeline.add_fault(step, "step", f"'{content.step}' has no outcome at this point; {expected} was expected")
        return None
    if content.outcome not in outcomes[content.step]:
        expected = " or ".join(outcomes[content.step])
        timeline.add_fault(step, "outcome", f"{content.outcome}: {content.step} ends {expected}")
        return None
    return StepOutcome(content.step, content.outcome)


def _mode(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    """Write a `mode` step."""
    modes = {role: mode for role in ("test", "load") if (mode := getattr(step.content, role)) is not None}
    if not modes:
        timeline.add_fault(step, (), "a mode for test, load or both was expected")
    for role, mode in modes.items():
        if timeline.setup == HEATED and mode is not Mode.OFF:
            timeline.add_fault(step, role, f"'{mode}': in set-up {HEATED} a supply feeds the leads; off was expected")
    timeline.engage(step, modes)


def _set(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Write a `set` step as a hold without duration."""
    content: SetStep = step.content
    spelling = timeline.spelling(step, content.role, content)
    if spelling is not None:
        value = content.value_of(spelling, "setpoint") * content.sign
        parameters = _hold_parameters(timeline, content.role, spelling, value, pass_number)
        timeline.hold(step, "set", (0.0, 0.0), content.role, value, parameters)


def _ramp(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Write a `ramp` step, whose duration is given or follows from its rate."""
    content: RampStep = step.content
    spelling = timeline.spelling(step, content.role, content)
    if spelling is None:
        return
    rate = content.value_of(spelling, "rate")
    if (rate is None) == (content.duration_s is None):
        timeline.add_fault(step, "duration_s", f"either duration_s or {spelling.rate} was expected")
        return
    stop = content.value_of(spelling, "to_setpoint") * content.sign
    start = timeline.setpoint_before_ramp(step, content.role, spelling.key("to_setpoint"))
    if start is not None:
        duration_s = content.duration_s or abs(stop - start) / rate
        parameters = {"role": content.role, "repeat": pass_number}
        timeline.ramp(step, content.role, (start, stop), duration_s, parameters, content.name)


def _hold(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Write a `hold` step; without a setpoint, every role keeps its own."""
    content: HoldStep = step.content
    timeline.check_times(step, ("settle_s", "duration_s"), content.duration_s, content.settle_s)
    times = content.duration_s, content.settle_s
    until = None
    if content.until is not None:
        required = content.until.otherwise == "fail"
        until = criterion(timeline, step, ("until", "duration_s"), times, required=required)
    setpoint_keys = [key for key in ("current_A", "velocity_rad_s", "angle_rad") if getattr(content, key) is not None]
    if not setpoint_keys:
        timeline.segment(step, content.name, times[0], {}, {"repeat": pass_number}, times[1], until)
        return
    if content.role is None:
        timeline.add_fault(step, "role", "is required and missing where a setpoint is given")
        return
    spelling = timeline.spelling(step, content.role, content)
    if spelling is not None:
        value = content.value_of(spelling, "setpoint") * content.sign
        parameters = _hold_parameters(timeline, content.role, spelling, value, pass_number)
        timeline.hold(step, content.name, times, content.role, value, parameters, until)


def _hold_parameters(
    timeline: Timeline, role: str, spelling: Spelling, value: float, pass_number: int
) -> dict[str, float | str]:
    """Return the parameters of a hold, and move the role's setpoint to its value."""
    direction = timeline.roles[role].move_to(value)
    return {spelling.setpoint: value, "direction": direction, "role": role, "repeat": pass_number}


def _signal(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Write a `signal` step; equal signals of a repeated step share their samples."""
    content: ProtocolSignal = step.content.in_pass(pass_number)
    spelling = timeline.spelling(step, content.role, content)
    setpoint_rate_hz = min(content.reference_Hz or math.inf, timeline.rate_hz)
    faults = list(content.faults(setpoint_rate_hz))
    if content.reference_Hz is not None and content.reference_Hz > timeline.rate_hz:
        message = f"{content.reference_Hz:g} Hz: rate_Hz ({timeline.rate_hz:g} Hz) or less was expected"
        faults.append(("reference_Hz", message))
    for key, message in faults:
        timeline.add_fault(step, key, message)
    if spelling is None or faults:
        return
    signal_key = step.location, spelling.setpoint, content
    if signal_key not in timeline.signals:
        samples = _samples(timeline, step, content, spelling)
        if samples is None:
            return
        timeline.signals[signal_key] = samples
    samples = timeline.signals[signal_key]
    duration = len(samples.values) * samples.period
    if content.settle_s >= duration:
        timeline.add_fault(step, "settle_s", f"{content.settle_s:g} s: less than {duration:g} s was expected")
    settings = content.model_dump(exclude_none=True, exclude={"role", "settle_s", "duration_s"})
    parameters = {key: value for key, value in settings.items() if isinstance(value, float | int | str)}
    parameters |= {"role": content.role, "repeat": pass_number}
    timeline.segment(step, content.kind, duration, {content.role: samples}, parameters, content.settle_s)
    timeline.roles[content.role].move_to(float(samples.values[-1]))


def _samples(timeline: Timeline, step: ProtocolStep, content: Any, spelling: Spelling) -> Samples | None:
    """Sample a signal at the rate of its setpoints; if it cannot be computed, add faults and return None."""
    import numpy as np

    rate_hz = content.reference_Hz or timeline.rate_hz
    period = 1 / rate_hz
    if isinstance(content, CsvSignal):
        try:
            times, setpoints = trajectory.read(timeline.folder / content.path, content.column, spelling)
        except InputError as error:
            for fault in error.faults:
                timeline.add_fault(step, "column" if fault.startswith("column ") else "path", fault)
            return None
        count = math.floor(float(times[-1]) * rate_hz + 1e-6) + 1
        timeline.count_towards_limits(step, steps=0, samples=count)
        values = np.interp(np.arange(count) * period, times, setpoints)
    else:
        count = round(content.duration_s * rate_hz)
        if count < 1:
            timeline.add_fault(step, "duration_s", f"{content.duration_s:g} s: at least {period:g} s was expected")
            return None
        timeline.count_towards_limits(step, steps=0, samples=count)
        try:
            values = content.values(np.arange(count) * period, spelling)
        except ValueError as error:
            timeline.add_fault(step, (), str(error))
            return None
    values.setflags(write=False)
    return Samples(period, values)


def _wait_until(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    """Write a `wait_until` step."""
    content: WaitStep = step.content
    low, high = bounds(timeline, step, content)
    timeline.add(step, WaitUntil(content.quantity, content.role, low, high, content.timeout_s))


def _record(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    """Write a `record` step; it is a fault if its rate does not divide the control rate."""
    rate_hz = step.content.rate_Hz
    if rate_hz and not divides(rate_hz, timeline.rate_hz):
        timeline.add_fault(
            step, "rate_Hz", f"{rate_hz:g} Hz: a whole part of rate_Hz ({timeline.rate_hz:g} Hz) was expected"
        )
    timeline.add(step, SetRecordRate(rate_hz))


def _tare(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    """Write a `tare` step, which takes one cycle for each sample."""
    timeline.add(step, Tare(step.content.samples))
    timeline.count_towards_limits(step, steps=0, duration_s=step.content.samples / timeline.rate_hz)


def _supply(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    """Write a `supply` step."""
    outputs = step.content.outputs
    if not outputs:
        timeline.add_fault(step, (), "an output for test, load or both was expected")
    if timeline.setup not in ("", HEATED):
        timeline.add_fault(step, (), f"a supply feeds leads in set-up {HEATED} alone; setup is {timeline.setup}")
    timeline.add(step, SetSupply(outputs))


def _prompt(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    """Write a `prompt` step."""
    if not step.content.isprintable():
        timeline.add_fault(step, (), "a text of one printable line was expected")
    timeline.add(step, Prompt(step.content))


_WRITERS: dict[str, Callable[[Timeline, ProtocolStep, int], None]] = {
    "mode": _mode,
    "set": _set,
    "ramp": _ramp,
    "hold": _hold,
    "bisect": bisect,
    "sweep": sweeps.sweep,
    "grid": sweeps.grid,
    "signal": _signal,
    "wait_until": _wait_until,
    "record": _record,
    "tare": _tare,
    "supply": _supply,
    "prompt": _prompt,
    "weigh": dead_weights.weigh,
}
