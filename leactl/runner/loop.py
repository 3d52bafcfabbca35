"""The control loop: each cycle passes setpoints on, exchanges, records, judges the samples and sends the heartbeat.

Every cycle is the same for every action of a plan, so that each movement, wait and prompt is supervised. The heartbeat
that keeps the drives running is sent after a supervised cycle and nowhere else.
"""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from leactl.bench.bench import Bench
from leactl.driver.contract import AnalogInput, Mode, Row, SampleBlock
from leactl.errors import DeviceError, InputError, Stopped
from leactl.protocol.plan import (
    Action,
    EndWhen,
    Engage,
    Hang,
    InRange,
    Plan,
    Prompt,
    Segment,
    SetpointProfile,
    SetRecordRate,
    SetSupply,
    Tare,
    Until,
    WaitUntil,
    When,
)
from leactl.runner.commanded import Commanded
from leactl.runner.criterion import Judge
from leactl.runner.flushing import Recording
from leactl.runner.step_outcomes import Outcomes
from leactl.runner.stop_requests import RunControl
from leactl.runner.watchdog import CYCLES, NoWatchdog, standstill_text
from leactl.safety.supervisor import Supervisor

ANSWER_SHARE = 0.6  # the drives' answers may take this share of a period
LEAST_ANSWER_S = 0.002  # the drives' answers may take as long, however short the period
SWITCH_TIMEOUT_S = 10.0  # a supply must report on or off in time; its driver raises earlier if the supply refuses
LONGEST_PAUSE_S = 3600.0  # after a longer pause nobody attends the bench any more, and the run ends in order
CUT_SHORT, NOT_JUDGED = "cut short", "not judged"  # outcomes of a criterion besides met and not met
NOTICE_CYCLES = 16  # notices are passed on in every 16th cycle: they cause no action, and would cost time in each


class Loop:
    """Executes the actions of a plan, one cycle after the other."""

    def __init__(
        self,
        plan: Plan,
        bench: Bench,
        supervisor: Supervisor,
        watchdog: NoWatchdog,
        control: RunControl,
        recording: Recording,
    ) -> None:
        self._plan, self._bench, self._supervisor = plan, bench, supervisor
        self._watchdog, self._sign = watchdog, watchdog.sign
        self._stop, self._operator_input, self._ask_operator = control.stop, control.operator_input, control.prompt
        self._writer, self._flush = recording.writer, recording.flush
        self._progress, self._limits = recording.progress, recording.limits
        self._commanded, self._pausing = Commanded(), False
        self.outcomes = Outcomes()
        self._clock = bench.clock
        self._period = 1.0 / plan.rate_Hz
        self._answer_s = max(ANSWER_SHARE * self._period, LEAST_ANSWER_S)
        self._start = self._next_start = self._clock.now()
        self._newest: dict[str, Sequence[float]] = {}
        self._progress.device_values = self._newest
        self._row: list[float] = []
        self._judged_row: Sequence[float] = ()  # the row that a criterion has taken last
        self._record_at(plan.record_Hz)
        self._planned_done_s = 0.0
        self.overruns = 0
        self.cycles = 0
        self.zeros: dict[str, tuple[float, float]] = {}  # of each tared channel, before and after [its unit]

    @property
    def time(self) -> float:
        """Start of the next cycle [s since the run's start]."""
        return self._next_start - self._start

    def run(self) -> None:
        """Execute the whole plan.

        Raises
        ------
        SafetyTrip, Stopped, DeviceError, RecordingFailed : the run ended early.
        """
        self._bench.pace(self._period)
        self._supervisor.begin(self._period)
        self._progress.windings, self._progress.time_left = self._supervisor.windings, self._supervisor.time_left
        self._progress.winding_limit = self._supervisor.winding_limit
        self._start = self._next_start = self._clock.now()  # the time of preparation is no standstill
        self._watchdog.begin(self._period)
        try:
            self._cycle()
            actions = iter(self._plan.actions)
            for action in actions:
                if isinstance(action, When):
                    self._decide(action, actions)
                    continue
                self._perform(action)
                if self._operator_input.pause_wanted() and self._commanded.rests:
                    self._pause()
            self._cycle()
        except BaseException as error:
            # first, because a drive's fault after a standstill is a consequence of it
            self._see_standstill(self._clock.now() - self._next_start)
            self._supervisor.latch(str(error))  # after a drive's fault as after a trip, nothing is commanded
            raise
        finally:
            self._pass_on_notices()

    def _perform(self, action: Action) -> None:
        """Execute one action of the plan."""
        match action:
            case Segment():
                self._move(action)
            case Engage():
                self._engage(action.modes)
            case SetSupply():
                self._supply(action.outputs)
            case WaitUntil():
                self._wait_until(action)
            case Tare():
                self._tare(action.samples)
            case Hang():
                self._prompt(action.text)
                self._bench.apply_weight_torque(action.torque)
            case Prompt():
                self._prompt(action.text)
            case SetRecordRate():
                self._record_at(action.rate_Hz)

    def _record_at(self, rate: float) -> None:
        """Record rows at this rate [Hz] from the next cycle on; at 0 record none."""
        self._cycles_per_row = round(self._plan.rate_Hz / rate) if rate else 0
        self._cycles_until_row = 0 if rate else -1

    def _decide(self, when: When, actions: Iterator[Action]) -> None:
        """Skip the actions under a condition that is not fulfilled, up to the end of the condition."""
        condition, reading_text = when.condition, ""
        if isinstance(condition, InRange):
            value = self._reading(condition.quantity, condition.role)
            fulfilled, reading_text = condition.low <= value <= condition.high, f", it is {value:.4g}"
            if math.isnan(value):
                self._progress.warnings.append(f"when {condition}: there is no reading, its steps are left out")
        else:
            fulfilled = self.outcomes.fulfils(condition)
        self._note("info", "runner", f"when {condition}{reading_text}: {'done' if fulfilled else 'left out'}")
        open_conditions = 0 if fulfilled else 1
        while open_conditions:
            action = next(actions)
            open_conditions += isinstance(action, When) - isinstance(action, EndWhen)
            self._planned_done_s += action.duration_s if isinstance(action, Segment) else 0.0
        self._progress.done_s = self._planned_done_s

    def _pause(self) -> None:
        """Run supervised cycles without new commands until the pause is ended.

        Raises
        ------
        Stopped : the pause has lasted longer than `LONGEST_PAUSE_S`.
        """
        began = self.time
        self._pausing = True
        self._note("info", "operator", "paused")
        try:
            while self._operator_input.pause_wanted():
                if self.time - began > LONGEST_PAUSE_S:
                    raise Stopped(f"paused for {LONGEST_PAUSE_S:g} s")
                self._cycle()
        finally:
            self._writer.step("pause", began, self.time, 0.0, {})
        self._pausing = False
        self._note("info", "operator", f"went on after a pause of {self.time - began:.4g} s")

    # -- one cycle ---------------------------------------------------------------------------------------------------

    def _cycle(self) -> None:
        """Run one cycle: exchange, record, judge, send the heartbeat, and wait for the start of the next cycle."""
        self._stop.check()
        bench, supervisor, writer, clock, start = self._bench, self._supervisor, self._writer, self._clock, self._start
        cycle_start = self._next_start
        row = self._row = bench.exchange(cycle_start + self._answer_s)
        if self._cycles_until_row == 0:
            self._cycles_until_row = self._cycles_per_row
            if row:
                writer.append_row("loop", cycle_start - start, row)
        self._cycles_until_row -= 1  # never reaches 0 if nothing is recorded
        readings = bench.take()
        for reading in readings:
            if isinstance(reading, SampleBlock):
                writer.append(reading.stream, reading.times - start, reading.values)
                self._newest[reading.stream] = reading.last.values
            else:
                writer.append_row(reading.stream, reading.time - start, reading.values)
                self._newest[reading.stream] = reading.values
            supervisor.receive(reading)
        supervisor.check(clock.now())
        bench.feed()
        if self._limits.any:
            self._judge(cycle_start, row, readings)
        self._flush.after_cycle()
        self.cycles += 1
        self._sign[CYCLES] += 1
        if supervisor.warnings or not self.cycles % NOTICE_CYCLES:
            supervisor.free_space(self._flush.free_bytes)
            self._pass_on_notices()
            self._see_watchdog()
        self._progress.values, self._progress.time_s = row, cycle_start - start
        period, now = self._period, clock.now()
        cycle_end = cycle_start + period
        if now > cycle_end + period:  # a cycle is lost: continue from now, and never catch up by two cycles in a row
            self._note_overrun(now - cycle_end)
            cycle_end = now
        clock.sleep_until(cycle_end)
        self._next_start = cycle_end

    def _see_standstill(self, silence_s: float) -> None:
        """Trip if the loop stood still for longer [s] than is allowed, unless a trip is latched already."""
        if silence_s > self._watchdog.allowed_s and not self._supervisor.tripped:
            self._supervisor.trip(
                standstill_text(os.getpid(), round(1e9 * silence_s), round(1e9 * self._watchdog.allowed_s))
            )

    def _note_overrun(self, late_s: float) -> None:
        """Count a cycle that ended this late [s]; trip if that is a standstill, and record some of the overruns."""
        self._see_standstill(late_s)
        self.overruns += 1
        if self.overruns in (1, 10, 100, 1000):
            self._note("warning", "runner", f"cycle late by {late_s * 1e3:.1f} ms; {self.overruns} so far")

    def _pass_on_notices(self) -> None:
        """Record and show what recorder, devices, operator, supervisor and flush have reported since the last call."""
        for text in self._writer.notes():
            self._note("warning", "recorder", text)
            self._progress.warnings.append(text)
        for source, text in self._bench.notices():
            self._note("warning", source, text)
        for text in self._operator_input.new_remarks():
            self._note("info", "operator", f"remark: {text}")
        pause_text = "paused" if self._pausing else "pauses at the next rest"
        self._progress.pause = pause_text if self._operator_input.pause_wanted() else ""
        for source, texts in (("safety", self._supervisor.take_warnings()), ("recorder", self._flush.warnings())):
            for text in texts:
                self._note("warning", source, text)
                self._progress.warnings.append(text)

    def _see_watchdog(self) -> None:
        """Trip if the watchdog's process has ended."""
        fault = self._watchdog.fault()
        if fault:
            self._supervisor.trip(fault)

    def _note(self, level: str, source: str, message: str) -> None:
        """Record an event of now."""
        self._writer.event(self._clock.now() - self._start, level, source, message)

    def _judge(self, cycle_start: float, row: Sequence[float], readings: Sequence[SampleBlock | Row]) -> None:
        """Compare the limits on channels with the row of a cycle and the samples of other streams."""
        if row:
            self._limits.receive("loop", cycle_start - self._start, row, self._note_limit)
        for reading in readings:
            if self._limits.watches(reading.stream):
                for sample in reading.rows() if isinstance(reading, SampleBlock) else (reading,):
                    self._limits.receive(sample.stream, sample.time - self._start, sample.values, self._note_limit)

    def _note_limit(self, level: str, text: str) -> None:
        """Record and show that a limit on a channel is broken."""
        self._note(level, "runner", text)
        self._progress.warnings.append(text)

    # -- actions -----------------------------------------------------------------------------------------------------

    def _move(self, planned_segment: Segment) -> None:
        """Follow the setpoints of a segment; record the step with its true duration, even if it is cut short."""
        segment = self.outcomes.chosen(planned_segment)
        began = self.time
        self._progress.step = segment.name
        setpoints = list(segment.setpoints.items())
        until, ending = segment.until, CUT_SHORT
        judge = None if until is None else Judge(until, began + segment.settle_s)
        parameters: dict[str, Any] = dict(segment.parameters)
        was_scaled = False
        if segment.duration_s > 0.0:
            self._limits.enter(segment.name, began + segment.settle_s)
        try:
            if segment.duration_s <= 0.0:
                self._command(setpoints, 0.0)
                return
            last_start = segment.duration_s - 0.5 * self._period
            while True:
                elapsed = self.time - began
                if elapsed >= last_start:
                    ending = "not met"
                    break
                self._command(setpoints, elapsed)
                was_scaled = was_scaled or (segment.trial is not None and self._is_scaled(setpoints))
                self._progress.done_s = self._planned_done_s + elapsed
                self._cycle()
                if until is not None and judge is not None and self._meets(until, judge):
                    ending = "met"
                    break
            self._command(setpoints, segment.duration_s)
            if segment.trial is not None and (was_scaled or (judge is not None and math.isnan(judge.latest))):
                ending = NOT_JUDGED
            elif until is not None:
                parameters |= self.outcomes.take(segment, ending == "met")
        finally:
            for role, profile in setpoints:
                self._commanded.move(role, profile.at(segment.duration_s))
            if segment.duration_s > 0.0:
                self._limits.leave(segment.name, self.time)
                parameters |= {} if judge is None else {"until": ending}
                self._writer.step(segment.name, began, self.time, segment.settle_s, parameters)
        self._planned_done_s += segment.duration_s
        if until is not None and judge is not None:
            setpoint_text = "".join(
                f" at {profile.at(0.0):g}" for _role, profile in setpoints if segment.trial is not None
            )
            result_text = f"{ending}{setpoint_text} after {self.time - began:.4g} s"
            self._note("info", "runner", f"{segment.name}: {until}: {result_text}, last {judge.latest:.4g}")
            if until.required and ending != "met":
                raise DeviceError(
                    f"{segment.name}: {until} was expected; {judge.latest:.4g} after {segment.duration_s:g} s"
                )
            if ending == NOT_JUDGED:
                reason = (
                    "the winding may not carry its current"
                    if was_scaled
                    else f"there are no readings of {until.quantity}"
                )
                raise DeviceError(f"{segment.name}: the trial{setpoint_text} cannot be judged: {reason}")
        if segment.trial is not None and (answer := self.outcomes.answer(segment.trial.search)):
            self._note("info", "runner", answer)

    def _is_scaled(self, setpoints: list[tuple[str, SetpointProfile]]) -> bool:
        """Return whether the supervisor scales any of the setpoints."""
        return any(self._supervisor.scales(role) for role, _profile in setpoints)

    def _meets(self, until: Until, judge: Judge) -> bool:
        """Pass the channel's newest sample to the criterion unless it has it; return whether the criterion is met."""
        values, column = self._newest_row(until.quantity, until.role)
        if values is not self._judged_row:
            self._judged_row = values
            judge.receive(self.time, values[column] if column < len(values) else math.nan)
        return judge.met(self.time)

    def _command(self, setpoints: list[tuple[str, SetpointProfile]], elapsed: float) -> None:
        """Pass on the setpoint of each role at a time since the start of the segment [s]."""
        for role, profile in setpoints:
            self._supervisor.command(role, profile.at(elapsed))

    def _engage(self, modes: Mapping[str, Mode]) -> None:
        """Engage or release drives and wait until each reports it; a drive makes one transition in a cycle."""
        for role, mode in modes.items():
            if role not in self._bench.drives:
                raise InputError(f"the protocol engages the {role} drive; bench '{self._bench.file.name}' has none")
            if mode is Mode.OFF:
                self._supervisor.release(role)
            else:
                self._supervisor.engage(role, mode)
            self._commanded.engage(role, mode)
        self._progress.step = "modes " + ", ".join(f"{role} {mode}" for role, mode in modes.items())
        self._note("info", "runner", self._progress.step)
        engaged = [role for role, mode in modes.items() if mode is not Mode.OFF]
        self._cycle()
        while not all(self._supervisor.engaged(role) for role in engaged):  # each driver raises when it takes too long
            self._cycle()
        self._cycle()

    def _supply(self, outputs: Mapping[str, tuple[float, float] | None]) -> None:
        """Switch supplies on at their levels, or off, and wait until each reports it."""
        supplies = self._supervisor.supplies
        levels = [
            f"{role} {f'{output[0]:g} V, {output[1]:g} A' if output else 'off'}" for role, output in outputs.items()
        ]
        self._progress.step = "supply " + ", ".join(levels)
        self._note("info", "runner", self._progress.step)
        for role, output in outputs.items():
            if output is None:
                supplies.switch_off(role)
                self._commanded.supply(role, False)
            else:
                self._commanded.supply(role, True)
                supplies.put_out(role, *output)
        deadline = self.time + SWITCH_TIMEOUT_S
        self._cycle()
        while unconfirmed_roles := [
            role for role, output in outputs.items() if supplies.supplying(role) is not (output is not None)
        ]:
            if self.time >= deadline:
                raise DeviceError(
                    f"the supply of {unconfirmed_roles[0]} does not report what was commanded: {', '.join(levels)}"
                )
            self._cycle()

    def _wait_until(self, action: WaitUntil) -> None:
        """Run cycles until a reading is in its range.

        Raises
        ------
        DeviceError : it is not within the action's timeout.
        """
        self._progress.step = f"wait for {action.role} {action.quantity}"
        deadline = self.time + action.timeout_s
        while not action.low <= self._reading(action.quantity, action.role) <= action.high:
            if self.time >= deadline:
                raise DeviceError(
                    f"{action.role} {action.quantity} is {self._reading(action.quantity, action.role):.4g} after"
                    f" {action.timeout_s:g} s; {action.low:g} to {action.high:g} was waited for"
                )
            self._cycle()

    def _reading(self, quantity: str, role: str) -> float:
        """Return the newest value of a quantity; before the first, NaN, which fails every comparison."""
        values, column = self._newest_row(quantity, role)
        return values[column] if column < len(values) else math.nan

    def _newest_row(self, quantity: str, role: str) -> tuple[Sequence[float], int]:
        """Return the newest row of the stream with a quantity, empty before the first row, and the quantity's column.

        Raises
        ------
        InputError : the bench does not measure it.
        """
        for stream, channels in self._bench.streams().items():
            for column, channel in enumerate(channels):
                if (channel.quantity, channel.role) == (quantity, role):
                    return (self._row if stream == "loop" else self._newest.get(stream, ())), column
        raise InputError(f"bench '{self._bench.file.name}' measures no {quantity} of role '{role}'")

    def _tare(self, samples: int) -> None:
        """Average this number of samples of each torque channel, and set its zero to the mean.

        Raises
        ------
        InputError : the bench has no torque sensor.
        """
        self._progress.step = "tare"
        devices = {
            driver: [
                spec.name for spec in driver.streams if any(channel.quantity == "torque" for channel in spec.channels)
            ]
            for driver in self._bench.drivers.values()
            if isinstance(driver, AnalogInput)
        }
        samples_by_stream: dict[str, list[float]] = {name: [] for names in devices.values() for name in names}
        if not samples_by_stream:
            raise InputError(f"bench '{self._bench.file.name}' has no torque sensor to tare")
        last_rows = dict(self._newest)
        while min(len(values) for values in samples_by_stream.values()) < samples:
            self._cycle()
            for name, values in samples_by_stream.items():
                row = self._newest.get(name)
                if row is not None and row is not last_rows.get(name):
                    values.append(row[0])
                    last_rows[name] = row
        self._planned_done_s += samples * self._period
        for driver, names in devices.items():
            means = {name: sum(samples_by_stream[name]) / len(samples_by_stream[name]) for name in names}
            offsets = driver.tare(means) if means else {}
            streams = {spec.channels[0].name: spec.name for spec in driver.streams}
            offset_changes = {name: (offset - means[streams[name]], offset) for name, offset in offsets.items()}
            self.zeros |= offset_changes
            for name, (previous_offset, offset) in offset_changes.items():
                self._note(
                    "info", "runner", f"tared: offset of {name} {offset:.6g} N*m, before {previous_offset:.6g} N*m"
                )

    def _prompt(self, text: str) -> None:
        """Ask the operator, and run cycles until the answer."""
        self._progress.step = self._progress.prompt = text
        self._note("info", "operator", f"asked: {text}")
        confirmed = self._ask_operator(text)
        while not confirmed():
            self._cycle()
        self._progress.prompt = ""
        self._note("info", "operator", "confirmed")
