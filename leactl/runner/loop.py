"""The control loop: setpoints through the supervisor, one exchange, samples to the file and the judge, sign of life.

Every cycle is the same whatever the plan asks for, so that nothing moves, waits or is asked without being supervised,
and the heartbeat that keeps the drives alive is sent after a supervised cycle and nowhere else.
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
from leactl.runner.signals import People
from leactl.runner.step_outcomes import Outcomes
from leactl.runner.watchdog import CYCLES, Unwatched, hung
from leactl.safety.supervisor import Supervisor

ANSWER_SHARE = 0.6  # of a period that the drives' answers may take
LEAST_ANSWER_S = 0.002
SWITCHED_S = 10.0  # a supply has to be on or off after; its driver gives up before where it is told that it is not
LONGEST_PAUSE_S = 3600.0  # after it nobody is beside the bench any more, and the run ends in order
CUT_SHORT, NOT_JUDGED = "cut short", "not judged"  # how a criterion may end, beside that it is met or not
NOTICES_EVERY = 16  # cycles: nothing is done about them, so they need not cost every cycle


class Loop:
    """Executes the actions of a plan, one cycle after the other."""

    def __init__(
        self,
        plan: Plan,
        bench: Bench,
        supervisor: Supervisor,
        watchdog: Unwatched,
        people: People,
        recording: Recording,
    ) -> None:
        self._plan, self._bench, self._supervisor = plan, bench, supervisor
        self._watchdog, self._sign = watchdog, watchdog.sign
        self._stop, self._wishes, self._operator = people.stop, people.wishes, people.operator
        self._writer, self._flush = recording.writer, recording.flush
        self._progress, self._limits = recording.progress, recording.limits
        self._commanded, self._pausing = Commanded(), False
        self.outcomes = Outcomes()
        self._clock = bench.clock
        self._period = 1.0 / plan.rate_Hz
        self._answer_s = max(ANSWER_SHARE * self._period, LEAST_ANSWER_S)
        self._start = self._next = self._clock.now()
        self._newest: dict[str, Sequence[float]] = {}
        self._progress.own = self._newest
        self._row: list[float] = []
        self._judged: Sequence[float] = ()  # the row that a criterion was given last
        self._record_at(plan.record_Hz)
        self._planned = 0.0
        self.overruns = 0
        self.cycles = 0
        self.zeros: dict[str, tuple[float, float]] = {}  # of each tared channel, before and after [its unit]

    @property
    def time(self) -> float:
        """Start of the next cycle [s since the run's start]."""
        return self._next - self._start

    def run(self) -> None:
        """Execute the whole plan.

        Raises
        ------
        SafetyTrip, Stopped, DeviceError, RecordingFailed : whatever ended it early.
        """
        self._bench.pace(self._period)
        self._supervisor.begin(self._period)
        self._progress.windings, self._progress.time_left = self._supervisor.windings, self._supervisor.time_left
        self._progress.winding_limit = self._supervisor.winding_limit
        self._start = self._next = self._clock.now()  # what was made ready until now is no standstill
        self._watchdog.begin(self._period)
        try:
            self._cycle()
            actions = iter(self._plan.actions)
            for action in actions:
                if isinstance(action, When):
                    self._decide(action, actions)
                    continue
                self._perform(action)
                if self._wishes.paused() and self._commanded.rests:
                    self._pause()
            self._cycle()
        except BaseException as error:
            self._see_standstill(self._clock.now() - self._next)  # first: what a drive says after it is its consequence
            self._supervisor.latch(str(error))  # a drive's fault as well as a trip: nothing is commanded after it
            raise
        finally:
            self._pass_on_notices()

    def _perform(self, action: Action) -> None:
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
                self._bench.hang(action.torque)
            case Prompt():
                self._prompt(action.text)
            case SetRecordRate():
                self._record_at(action.rate_Hz)

    def _record_at(self, rate: float) -> None:
        """Record rows at this rate [Hz] from the next cycle on; 0 records none."""
        self._every = round(self._plan.rate_Hz / rate) if rate else 0
        self._until_row = 0 if rate else -1

    def _decide(self, when: When, actions: Iterator[Action]) -> None:
        """Leave out what follows a condition, up to its end, where it is not fulfilled."""
        condition, known = when.condition, ""
        if isinstance(condition, InRange):
            value = self._reading(condition.quantity, condition.role)
            fulfilled, known = condition.low <= value <= condition.high, f", it is {value:.4g}"
            if math.isnan(value):
                self._progress.warnings.append(f"when {condition}: there is no reading, its steps are left out")
        else:
            fulfilled = self.outcomes.fulfils(condition)
        self._note("info", "runner", f"when {condition}{known}: {'done' if fulfilled else 'left out'}")
        opened = 0 if fulfilled else 1
        while opened:
            action = next(actions)
            opened += isinstance(action, When) - isinstance(action, EndWhen)
            self._planned += action.duration_s if isinstance(action, Segment) else 0.0
        self._progress.done_s = self._planned

    def _pause(self) -> None:
        """Go on with supervised cycles, and nothing commanded, until people want the run to go on.

        Raises
        ------
        Stopped : nobody has wanted it for `LONGEST_PAUSE_S`.
        """
        began = self.time
        self._pausing = True
        self._note("info", "operator", "paused")
        try:
            while self._wishes.paused():
                if self.time - began > LONGEST_PAUSE_S:
                    raise Stopped(f"paused for {LONGEST_PAUSE_S:g} s")
                self._cycle()
        finally:
            self._writer.step("pause", began, self.time, 0.0, {})
        self._pausing = False
        self._note("info", "operator", f"went on after a pause of {self.time - began:.4g} s")

    # -- one cycle ---------------------------------------------------------------------------------------------------

    def _cycle(self) -> None:
        """Exchange, record, judge, feed, and wait for the next cycle's start."""
        self._stop.check()
        bench, supervisor, writer, clock, start = self._bench, self._supervisor, self._writer, self._clock, self._start
        began = self._next
        row = self._row = bench.exchange(began + self._answer_s)
        if self._until_row == 0:
            self._until_row = self._every
            if row:
                writer.append_row("loop", began - start, row)
        self._until_row -= 1  # never comes to 0 where nothing is recorded
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
            self._judge(began, row, readings)
        self._flush.after_cycle()
        self.cycles += 1
        self._sign[CYCLES] += 1
        if supervisor.warnings or not self.cycles % NOTICES_EVERY:
            supervisor.free_space(self._flush.free_bytes)
            self._pass_on_notices()
            self._see_watchdog()
        self._progress.values, self._progress.time_s = row, began - start
        period, now = self._period, clock.now()
        due = began + period
        if now > due + period:  # a cycle is lost: go on from here, never two cycles in a row to catch up
            self._note_overrun(now - due)
            due = now
        clock.sleep_until(due)
        self._next = due

    def _see_standstill(self, late: float) -> None:
        """Trip a loop that stood still longer than it may, where its watchdog had no time to look."""
        if late > self._watchdog.allowed_s and not self._supervisor.tripped:
            self._supervisor.trip(hung(os.getpid(), round(1e9 * late), round(1e9 * self._watchdog.allowed_s)))

    def _note_overrun(self, late: float) -> None:
        self._see_standstill(late)
        self.overruns += 1
        if self.overruns in (1, 10, 100, 1000):
            self._note("warning", "runner", f"cycle late by {late * 1e3:.1f} ms; {self.overruns} so far")

    def _pass_on_notices(self) -> None:
        for text in self._writer.notes():
            self._note("warning", "recorder", text)
            self._progress.warnings.append(text)
        for source, text in self._bench.notices():
            self._note("warning", source, text)
        for text in self._wishes.remarks():
            self._note("info", "operator", f"remark: {text}")
        wanted = "paused" if self._pausing else "pauses at the next rest"
        self._progress.pause = wanted if self._wishes.paused() else ""
        for source, texts in (("safety", self._supervisor.take_warnings()), ("recorder", self._flush.warnings())):
            for text in texts:
                self._note("warning", source, text)
                self._progress.warnings.append(text)

    def _see_watchdog(self) -> None:
        fault = self._watchdog.fault()
        if fault:
            self._supervisor.trip(fault)

    def _note(self, level: str, source: str, message: str) -> None:
        self._writer.event(self._clock.now() - self._start, level, source, message)

    def _judge(self, began: float, row: Sequence[float], readings: Sequence[SampleBlock | Row]) -> None:
        """Hold the limits on channels against a cycle's row and what the devices gave at their own pace."""
        if row:
            self._limits.receive("loop", began - self._start, row, self._note_limit)
        for reading in readings:
            if self._limits.watches(reading.stream):
                for each in reading.rows() if isinstance(reading, SampleBlock) else (reading,):
                    self._limits.receive(each.stream, each.time - self._start, each.values, self._note_limit)

    def _note_limit(self, level: str, text: str) -> None:
        self._note(level, "runner", text)
        self._progress.warnings.append(text)

    # -- actions -----------------------------------------------------------------------------------------------------

    def _move(self, planned: Segment) -> None:
        """Follow setpoints; the step is noted with the time it really took, even where it is cut short."""
        segment = self.outcomes.chosen(planned)
        began = self.time
        self._progress.step = segment.name
        setpoints = list(segment.setpoints.items())
        until, ended = segment.until, CUT_SHORT
        judge = None if until is None else Judge(until, began + segment.settle_s)
        parameters: dict[str, Any] = dict(segment.parameters)
        scaled = False
        if segment.duration_s > 0.0:
            self._limits.enter(segment.name, began + segment.settle_s)
        try:
            if segment.duration_s <= 0.0:
                self._command(setpoints, 0.0)
                return
            last = segment.duration_s - 0.5 * self._period
            while True:
                into = self.time - began
                if into >= last:
                    ended = "not met"
                    break
                self._command(setpoints, into)
                scaled = scaled or (segment.trial is not None and self._scaled(setpoints))
                self._progress.done_s = self._planned + into
                self._cycle()
                if until is not None and judge is not None and self._meets(until, judge):
                    ended = "met"
                    break
            self._command(setpoints, segment.duration_s)
            if segment.trial is not None and (scaled or (judge is not None and math.isnan(judge.latest))):
                ended = NOT_JUDGED
            elif until is not None:
                parameters |= self.outcomes.take(segment, ended == "met")
        finally:
            for role, profile in setpoints:
                self._commanded.move(role, profile.at(segment.duration_s))
            if segment.duration_s > 0.0:
                self._limits.leave(segment.name, self.time)
                parameters |= {} if judge is None else {"until": ended}
                self._writer.step(segment.name, began, self.time, segment.settle_s, parameters)
        self._planned += segment.duration_s
        if until is not None and judge is not None:
            at = "".join(f" at {profile.at(0.0):g}" for _role, profile in setpoints if segment.trial is not None)
            came = f"{ended}{at} after {self.time - began:.4g} s"
            self._note("info", "runner", f"{segment.name}: {until}: {came}, last {judge.latest:.4g}")
            if until.required and ended != "met":
                raise DeviceError(
                    f"{segment.name}: {until} was expected; {judge.latest:.4g} after {segment.duration_s:g} s"
                )
            if ended == NOT_JUDGED:
                why = (
                    "the winding may not carry its current" if scaled else f"there are no readings of {until.quantity}"
                )
                raise DeviceError(f"{segment.name}: the trial{at} cannot be judged: {why}")
        if segment.trial is not None and (answer := self.outcomes.answer(segment.trial.search)):
            self._note("info", "runner", answer)

    def _scaled(self, setpoints: list[tuple[str, SetpointProfile]]) -> bool:
        return any(self._supervisor.scales(role) for role, _profile in setpoints)

    def _meets(self, until: Until, judge: Judge) -> bool:
        """Give the channel's newest sample, each once, and ask whether the criterion is met."""
        values, place = self._newest_row(until.quantity, until.role)
        if values is not self._judged:
            self._judged = values
            judge.receive(self.time, values[place] if place < len(values) else math.nan)
        return judge.met(self.time)

    def _command(self, setpoints: list[tuple[str, SetpointProfile]], into: float) -> None:
        for role, profile in setpoints:
            self._supervisor.command(role, profile.at(into))

    def _engage(self, modes: Mapping[str, Mode]) -> None:
        """Bring drives into operation or out of it; each takes one transition a cycle."""
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
        while not all(self._supervisor.engaged(role) for role in engaged):  # the driver itself gives up in time
            self._cycle()
        self._cycle()

    def _supply(self, outputs: Mapping[str, tuple[float, float] | None]) -> None:
        """Have supplies put out, or no more, and wait until each reports that it does."""
        supplies = self._supervisor.supplies
        told = [f"{role} {f'{one[0]:g} V, {one[1]:g} A' if one else 'off'}" for role, one in outputs.items()]
        self._progress.step = "supply " + ", ".join(told)
        self._note("info", "runner", self._progress.step)
        for role, output in outputs.items():
            if output is None:
                supplies.switch_off(role)
                self._commanded.supply(role, False)
            else:
                self._commanded.supply(role, True)
                supplies.put_out(role, *output)
        end = self.time + SWITCHED_S
        self._cycle()
        while waiting := [role for role, one in outputs.items() if supplies.supplying(role) is not (one is not None)]:
            if self.time >= end:
                raise DeviceError(f"the supply of {waiting[0]} does not report what was commanded: {', '.join(told)}")
            self._cycle()

    def _wait_until(self, action: WaitUntil) -> None:
        self._progress.step = f"wait for {action.role} {action.quantity}"
        end = self.time + action.timeout_s
        while not action.low <= self._reading(action.quantity, action.role) <= action.high:
            if self.time >= end:
                raise DeviceError(
                    f"{action.role} {action.quantity} is {self._reading(action.quantity, action.role):.4g} after"
                    f" {action.timeout_s:g} s; {action.low:g} to {action.high:g} was waited for"
                )
            self._cycle()

    def _reading(self, quantity: str, role: str) -> float:
        """Newest value of a quantity; NaN, which no comparison holds for, where there is none yet."""
        values, place = self._newest_row(quantity, role)
        return values[place] if place < len(values) else math.nan

    def _newest_row(self, quantity: str, role: str) -> tuple[Sequence[float], int]:
        """The newest row of the stream that a quantity comes in, empty where there is none yet, and its column."""
        for stream, channels in self._bench.streams().items():
            for place, channel in enumerate(channels):
                if (channel.quantity, channel.role) == (quantity, role):
                    return (self._row if stream == "loop" else self._newest.get(stream, ())), place
        raise InputError(f"bench '{self._bench.file.name}' measures no {quantity} of role '{role}'")

    def _tare(self, samples: int) -> None:
        """Average the torque readings of so many samples and take the means as zero."""
        self._progress.step = "tare"
        devices = {
            driver: [spec.name for spec in driver.streams if any(c.quantity == "torque" for c in spec.channels)]
            for driver in self._bench.drivers.values()
            if isinstance(driver, AnalogInput)
        }
        gathered: dict[str, list[float]] = {name: [] for names in devices.values() for name in names}
        if not gathered:
            raise InputError(f"bench '{self._bench.file.name}' has no torque sensor to tare")
        self._newest.clear()
        while min(len(values) for values in gathered.values()) < samples:
            self._cycle()
            for name, values in gathered.items():
                if name in self._newest:
                    values.append(self._newest.pop(name)[0])
        self._planned += samples * self._period
        for driver, names in devices.items():
            means = {name: sum(gathered[name]) / len(gathered[name]) for name in names}
            after = driver.tare(means) if means else {}
            streams = {spec.channels[0].name: spec.name for spec in driver.streams}
            zeros = {name: (offset - means[streams[name]], offset) for name, offset in after.items()}
            self.zeros |= zeros
            for name, (before, offset) in zeros.items():
                self._note("info", "runner", f"tared: offset of {name} {offset:.6g} N*m, before {before:.6g} N*m")

    def _prompt(self, text: str) -> None:
        """Ask the operator, and keep the loop going until the answer."""
        self._progress.step = self._progress.prompt = text
        self._note("info", "operator", f"asked: {text}")
        confirmed = self._operator(text)
        while not confirmed():
            self._cycle()
        self._progress.prompt = ""
        self._note("info", "operator", "confirmed")
