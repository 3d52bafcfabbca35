"""Rehearses on a real bench what needs no fault put into it: stops, and a sensor that a person unplugs.

Setpoints are harmless, everything is explained and asked for before, and the runs go the way of every run: locks, latch
and watchdog are those of the bench.
"""

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from leactl.bench import benchfile
from leactl.driver import registry
from leactl.driver.contract import SAFE_STATE_S
from leactl.emulation.faults import known_faults
from leactl.errors import InputError, Stopped
from leactl.protocol import by_hand
from leactl.runfile.verify.integrity import verify
from leactl.runner import latch
from leactl.runner.drill.emulated import STOPPED, drives, setup_of
from leactl.runner.drill.finding import (
    CAUGHT,
    DeviceEnd,
    Drilled,
    DrillFinding,
    PlannedDrill,
    PlannedRehearsal,
    of_the_end,
)
from leactl.runner.dry_run import dry_run
from leactl.runner.operators import granted, keyboard
from leactl.runner.outcome import Outcome
from leactl.runner.request import Request, prepare_by_hand
from leactl.runner.session import execute

MOST_CURRENT_A, MOST_VELOCITY_RAD_S = 1.0, 1.0  # or a twentieth of the bench's limits
STOP_AFTER_S, PATIENCE_S = 1.0, 30.0
KEY_PRESSED = "stopped by the operator: key"
STOP, KEY, UNPLUGGED, DEAD_MAN = "stop", "operator_stop", "sensor_unplugged", "dead_man"
NAMES = (STOP, KEY, UNPLUGGED, DEAD_MAN)


@dataclass(frozen=True)
class Person:
    """Who stands at the bench."""

    agrees: Callable[[str], bool]
    tell: Callable[[str], None]
    present: bool  # at a terminal, to press and to unplug


class _Exercise(NamedTuple):
    """What is rehearsed by one run."""

    name: str
    explained: str
    by_a_person: bool
    steps: Sequence[str]  # of its run
    rehearse: Callable[[], DrillFinding]


class RealDrill:
    """The drill of one real bench, or of an emulated one that another process serves."""

    def __init__(
        self,
        bench: str,
        only: Collection[str],
        directory: Path,
        person: Person,
        served: bool = False,
        buses: Sequence[str] = (),
    ) -> None:
        """Check what is to be rehearsed.

        Raises
        ------
        InputError : no such bench, a name that is none of these rehearsals', or no drive that could be moved.
        """
        self._file, devices, _document = benchfile.load(bench)
        unknown = [name for name in only if name not in NAMES]
        if unknown:
            known = f"known on a real bench: {', '.join(NAMES)}"
            raise InputError([f"--only {name}: no fault can be put into a real bench; {known}" for name in unknown])
        self._bench, self._directory, self._person = bench, directory, person
        self._served, self._buses = served, buses
        self._only = set(only) or set(NAMES)
        roles = drives(devices)
        self._setup = setup_of(self._file, roles)
        limits = self._file.limits
        self._velocity = min(MOST_VELOCITY_RAD_S, 0.05 * limits.velocity_rad_s)
        self._current = min(MOST_CURRENT_A, 0.05 * limits.current_A)
        self._roles = roles.values()
        self._moving(PATIENCE_S)  # refused here where nothing could be moved
        measuring = (device.name for device in devices if hasattr(registry.load(device.entry.driver), "tare"))
        self._sensor = next(measuring, "")
        silences = benchfile.host_silences(devices)
        self._silence_s = max((silence for silence in silences.values() if silence), default=0.0)

    def run(self) -> Drilled:
        """Rehearse one after the other; the one that latches the bench comes last.

        Raises
        ------
        Stopped, SafetyTrip, DeviceError, RecordingFailed : as of any run.
        """
        findings: list[DrillFinding] = []
        left_out = self._left_out()
        for exercise in self._exercises():
            if exercise.name in left_out:
                continue
            if self._person.agrees(f"{exercise.name}: {exercise.explained}"):
                findings.append(exercise.rehearse())
            else:
                left_out[exercise.name] = "not agreed to"
        return Drilled(self._file.name, False, findings, left_out | self._catalogue)

    def planned(self) -> PlannedDrill:
        """Return what `run` would rehearse if a person agreed to all of it; no device is opened.

        Raises
        ------
        InputError, SafetyTrip, DeviceError : as of any run, before a device is opened.
        """
        left_out = self._left_out()
        planned = []
        devices: list[str] = []
        for exercise in self._exercises():
            if exercise.name not in left_out:
                request = self._request(exercise.steps)
                devices = [device.name for device in request.devices]  # of each run the same
                plan = dry_run(request).plan
                on = self._sensor if exercise.name == UNPLUGGED else ""
                planned.append(PlannedRehearsal(exercise.name, on, exercise.explained, plan))
        return PlannedDrill(self._file.name, False, devices, planned, left_out | self._catalogue)

    def _exercises(self) -> list[_Exercise]:
        """What was chosen; the one that latches the bench comes last."""
        motion = f"at {self._velocity:g} rad/s and {self._current:g} A at the most; keep clear of the shaft"
        stopped = f"The drives move for {STOP_AFTER_S:g} s and are stopped, {motion}."
        pressed = f"The drives move until you press space or q, {motion}."
        unplugged = f"Drives off; you unplug {self._sensor} and the bench has to trip. It stays latched afterwards."
        every = (
            _Exercise(STOP, stopped, False, self._moving(STOP_AFTER_S + PATIENCE_S), self._stop),
            _Exercise(KEY, pressed, True, self._moving(PATIENCE_S), self._key),
            _Exercise(UNPLUGGED, unplugged, True, by_hand.reading_steps(PATIENCE_S), self._unplugged),
        )
        return [exercise for exercise in every if exercise.name in self._only]

    def _left_out(self) -> dict[str, str]:
        """What of the exercises cannot be rehearsed here, and why."""
        left_out = {DEAD_MAN: self._by_hand} if DEAD_MAN in self._only else {}
        for exercise in self._exercises():
            if exercise.name == UNPLUGGED and not self._sensor:
                left_out[exercise.name] = "no sensor on an analogue input"
            elif exercise.by_a_person and not self._person.present:
                left_out[exercise.name] = "it takes a person at a terminal"
        return left_out

    @property
    def _catalogue(self) -> dict[str, str]:
        """Why no fault is rehearsed."""
        return {f"{len(known_faults())} faults of the catalogue": "no fault can be put into a real bench"}

    @property
    def _by_hand(self) -> str:
        """How a person tries the dead-man: no part of a run can let a drive starve, and none should."""
        return (
            f"nothing here lets a drive starve; by hand: `leactl bench jog {self._bench} --current 0 --for 20`,"
            f" `kill -9` of its process, and the drive's own display: out of operation within {self._silence_s:g} s"
        )

    def _moving(self, hold_s: float) -> list[str]:
        return by_hand.motion_steps(self._setup, self._roles, self._velocity, self._current, hold_s)

    def _stop(self) -> DrillFinding:
        cycles: list[float] = []
        asked: list[float] = []

        def source() -> str:
            cycles.append(time.monotonic())
            if cycles[-1] - cycles[0] < STOP_AFTER_S:
                return ""
            asked.append(cycles[-1])
            return STOPPED

        outcome, safe_at = self._run(self._moving(STOP_AFTER_S + PATIENCE_S), [source], cause=STOPPED)
        took = safe_at - asked[0] if asked else None
        return self._finding(STOP, "", "the stop request", SAFE_STATE_S, outcome, ["stopped"], took)

    def _key(self) -> DrillFinding:
        with keyboard(shown=True) as keys:
            what = f"Press space or q now: {PATIENCE_S:g} s are left."
            outcome, _safe_at = self._run(self._moving(PATIENCE_S), [keys.pressed], what, KEY_PRESSED)
        return self._finding(KEY, "", "the operator's key", None, outcome, ["stopped"], None)

    def _unplugged(self) -> DrillFinding:
        what = f"Unplug {self._sensor} now: {PATIENCE_S:g} s are left."
        outcome, _safe_at = self._run(by_hand.reading_steps(PATIENCE_S), [], what)
        return self._finding(UNPLUGGED, self._sensor, "an interlock or the device itself", None, outcome, CAUGHT, None)

    def _run(
        self, steps: Sequence[str], stops: Sequence[Callable[[], str]], asked: str = "", cause: str = ""
    ) -> tuple[Outcome, float]:
        """One run, and when its devices had been made safe by `time.monotonic`.

        Raises
        ------
        Stopped : it was stopped by another cause than this.
        """
        request = self._request(steps)
        safe_at: list[float] = []

        @contextmanager
        def watch(_progress: object) -> Iterator[None]:
            if asked:
                self._person.tell(asked)
            yield
            safe_at.append(time.monotonic())

        outcome = execute(request, granted, watch, stops)
        if isinstance(outcome.error, Stopped) and not (cause and outcome.reason.startswith(cause)):
            raise outcome.error
        return outcome, safe_at[0]

    def _request(self, steps: Sequence[str]) -> Request:
        return prepare_by_hand(
            "drill", steps, self._bench, self._setup, self._directory, False, self._served, self._buses
        )

    def _finding(
        self,
        name: str,
        on: str,
        ought: str,
        within_s: float | None,
        outcome: Outcome,
        wanted: Sequence[str],
        took: float | None,
    ) -> DrillFinding:
        ends = {device: DeviceEnd(end.safe, end.detail, None) for device, end in outcome.safe.items()}
        if name == UNPLUGGED:  # which cannot confirm anything, and has no power to take away
            ends.pop(on, None)
        faults = of_the_end(outcome, wanted, ends)
        if took is not None and within_s is not None and took > within_s:
            faults.append(f"safe after {took:.2f} s; {within_s:g} s were expected")
        faults += [f"run file: {text}" for text in verify(outcome.path)]
        held = latch.tripped(self._bench)
        notes = [f"the bench is latched: leactl bench reset {self._bench}"] if held else []
        return DrillFinding(
            name,
            on,
            {},
            ought,
            within_s,
            outcome.status,
            outcome.reason,
            took,
            None,
            ends,
            faults,
            notes,
            str(outcome.path),
        )
