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
            timeline.foresee(step, times * len(step.inner))
            for number in range(1, times + 1):
                timeline.charge(step)
                expand(timeline, step.inner, (pass_number - 1) * times + number)
        elif step.kind == "when":
            _when(timeline, step, pass_number)
        elif step.content is None:
            timeline.charge(step)
            timeline.fault_free = False
            timeline.modes_known = timeline.modes_known and step.kind != "mode"
        else:
            _WRITERS[step.kind](timeline, step, pass_number)


def _when(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    """Write conditional steps; it is a fault if modes or setpoints after them differ from those before."""
    condition = None if step.content is None else _condition(timeline, step)
    before = {role: (followed.mode, followed.setpoint) for role, followed in timeline.roles.items()}
    began = len(timeline.actions)
    if condition is not None:
        timeline.add(step, When(condition))
    expand(timeline, step.inner, pass_number)
    if condition is not None:
        timeline.add(step, EndWhen())
    timeline.fault_free = timeline.fault_free and condition is not None
    if any(isinstance(action, SetRecordRate | SetSupply) for action in timeline.actions[began:]):
        timeline.complain(step, "steps", "a record or supply step would outlast the condition; none was expected")
    for role, (mode, setpoint) in before.items() if timeline.fault_free else ():
        followed = timeline.roles[role]
        if (followed.mode, followed.setpoint) != (mode, setpoint):
            known = "off" if mode is Mode.OFF else f"{mode} at {'its angle' if setpoint is None else f'{setpoint:g}'}"
            message = f"{role} is not left as it was; {known}, as before the condition, was expected at the end"
            timeline.complain(step, "steps", message)


def _condition(timeline: Timeline, step: ProtocolStep) -> StepOutcome | InRange | None:
    """Return the condition of a `when` step; if it is invalid, add faults and return None."""
    content: WhenStep = step.content
    reading = ("quantity", "role", "below", "above", "unit")
    reading_keys = [key for key in reading if getattr(content, key) is not None]
    if content.step is None and content.outcome is None:
        missing = [key for key in ("quantity", "role", "unit") if key not in reading_keys]
        if missing:
            timeline.complain(step, missing[0], "is required and missing; or step and outcome of an earlier step")
            return None
        return InRange(content.quantity or "", content.role or "", *bounds(timeline, step, content))
    if reading_keys:
        timeline.complain(step, reading_keys[0], "either step and outcome, or a reading with its bounds, was expected")
        return None
    if content.step is None or content.outcome is None:
        timeline.complain(step, "step" if content.step is None else "outcome", "is required and missing")
        return None
    outcomes = timeline.outcomes
    if content.step not in outcomes:
        known = f"one of {', '.join(outcomes)}" if outcomes else "a bisect, or a hold with until, before it"
        timeline.complain(step, "step", f"'{content.step}' has no outcome at this point; {known} was expected")
        return None
    if content.outcome not in outcomes[content.step]:
        expected = " or ".join(outcomes[content.step])
        timeline.complain(step, "outcome", f"{content.outcome}: {content.step} ends {expected}")
        return None
    return StepOutcome(content.step, content.outcome)


def _mode(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    modes = {role: mode for role in ("test", "load") if (mode := getattr(step.content, role)) is not None}
    if not modes:
        timeline.complain(step, (), "a mode for test, load or both was expected")
    for role, mode in modes.items():
        if timeline.setup == HEATED and mode is not Mode.OFF:
            timeline.complain(step, role, f"'{mode}': in set-up {HEATED} a supply feeds the leads; off was expected")
    timeline.engage(step, modes)


def _set(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    content: SetStep = step.content
    spelling = timeline.spelling(step, content.role, content)
    if spelling is not None:
        value = content.given(spelling, "setpoint") * content.sign
        parameters = _hold_parameters(timeline, content.role, spelling, value, pass_number)
        timeline.hold(step, "set", (0.0, 0.0), content.role, value, parameters)


def _ramp(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    content: RampStep = step.content
    spelling = timeline.spelling(step, content.role, content)
    if spelling is None:
        return
    rate = content.given(spelling, "rate")
    if (rate is None) == (content.duration_s is None):
        timeline.complain(step, "duration_s", f"either duration_s or {spelling.rate} was expected")
        return
    value = content.given(spelling, "to_setpoint") * content.sign
    before = timeline.known_setpoint(step, content.role, spelling.key("to_setpoint"))
    if before is not None:
        duration_s = content.duration_s or abs(value - before) / rate
        where = {"role": content.role, "repeat": pass_number}
        timeline.ramp(step, content.role, (before, value), duration_s, where, content.name)


def _hold(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    content: HoldStep = step.content
    timeline.check_times(step, ("settle_s", "duration_s"), content.duration_s, content.settle_s)
    times = content.duration_s, content.settle_s
    until = None
    if content.until is not None:
        required = content.until.otherwise == "fail"
        until = criterion(timeline, step, ("until", "duration_s"), times, required=required)
    setpoints = [key for key in ("current_A", "velocity_rad_s", "angle_rad") if getattr(content, key) is not None]
    if not setpoints:
        timeline.segment(step, content.name, times[0], {}, {"repeat": pass_number}, times[1], until)
        return
    if content.role is None:
        timeline.complain(step, "role", "is required and missing where a setpoint is given")
        return
    spelling = timeline.spelling(step, content.role, content)
    if spelling is not None:
        value = content.given(spelling, "setpoint") * content.sign
        parameters = _hold_parameters(timeline, content.role, spelling, value, pass_number)
        timeline.hold(step, content.name, times, content.role, value, parameters, until)


def _hold_parameters(
    timeline: Timeline, role: str, spelling: Spelling, value: float, pass_number: int
) -> dict[str, float | str]:
    direction = timeline.roles[role].goes_to(value)
    return {spelling.setpoint: value, "direction": direction, "role": role, "repeat": pass_number}


def _signal(timeline: Timeline, step: ProtocolStep, pass_number: int) -> None:
    content: ProtocolSignal = step.content.in_pass(pass_number)
    spelling = timeline.spelling(step, content.role, content)
    rate = min(content.reference_Hz or math.inf, timeline.rate_hz)
    faults = list(content.faults(rate))
    if content.reference_Hz is not None and content.reference_Hz > timeline.rate_hz:
        message = f"{content.reference_Hz:g} Hz: rate_Hz ({timeline.rate_hz:g} Hz) or less was expected"
        faults.append(("reference_Hz", message))
    for key, message in faults:
        timeline.complain(step, key, message)
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
        timeline.complain(step, "settle_s", f"{content.settle_s:g} s: less than {duration:g} s was expected")
    keys = content.model_dump(exclude_none=True, exclude={"role", "settle_s", "duration_s"})
    parameters = {key: value for key, value in keys.items() if isinstance(value, float | int | str)}
    parameters |= {"role": content.role, "repeat": pass_number}
    timeline.segment(step, content.kind, duration, {content.role: samples}, parameters, content.settle_s)
    timeline.roles[content.role].goes_to(float(samples.values[-1]))


def _samples(timeline: Timeline, step: ProtocolStep, content: Any, spelling: Spelling) -> Samples | None:
    """Sample a signal at the rate of its setpoints; if it cannot be computed, add faults and return None."""
    import numpy as np

    rate = content.reference_Hz or timeline.rate_hz
    period = 1 / rate
    if isinstance(content, CsvSignal):
        try:
            times, column = trajectory.read(timeline.folder / content.path, content.column, spelling)
        except InputError as error:
            for fault in error.faults:
                timeline.complain(step, "column" if fault.startswith("column ") else "path", fault)
            return None
        count = math.floor(float(times[-1]) * rate + 1e-6) + 1
        timeline.charge(step, steps=0, samples=count)
        values = np.interp(np.arange(count) * period, times, column)
    else:
        count = round(content.duration_s * rate)
        if count < 1:
            timeline.complain(step, "duration_s", f"{content.duration_s:g} s: at least {period:g} s was expected")
            return None
        timeline.charge(step, steps=0, samples=count)
        try:
            values = content.values(np.arange(count) * period, spelling)
        except ValueError as error:
            timeline.complain(step, (), str(error))
            return None
    values.setflags(write=False)
    return Samples(period, values)


def _wait_until(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    content: WaitStep = step.content
    low, high = bounds(timeline, step, content)
    timeline.add(step, WaitUntil(content.quantity, content.role, low, high, content.timeout_s))


def _record(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    rate = step.content.rate_Hz
    if rate and not divides(rate, timeline.rate_hz):
        timeline.complain(
            step, "rate_Hz", f"{rate:g} Hz: a whole part of rate_Hz ({timeline.rate_hz:g} Hz) was expected"
        )
    timeline.add(step, SetRecordRate(rate))


def _tare(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    timeline.add(step, Tare(step.content.samples))
    timeline.charge(step, steps=0, duration_s=step.content.samples / timeline.rate_hz)


def _supply(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    outputs = step.content.outputs
    if not outputs:
        timeline.complain(step, (), "an output for test, load or both was expected")
    if timeline.setup not in ("", HEATED):
        timeline.complain(step, (), f"a supply feeds leads in set-up {HEATED} alone; setup is {timeline.setup}")
    timeline.add(step, SetSupply(outputs))


def _prompt(timeline: Timeline, step: ProtocolStep, _pass_number: int) -> None:
    if not step.content.isprintable():
        timeline.complain(step, (), "a text of one printable line was expected")
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
