"""Rehearse on a real bench the cases that need no injected fault: stops, and a sensor that a person unplugs.

Setpoints are small, and a person agrees to each rehearsal before it begins. The runs are executed as any other run,
with the locks, latch and watchdog of the bench.
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
from leactl.runner.drill.emulated import STOP_REASON, drives, setup_of
from leactl.runner.drill.finding import (
    CAUGHT_STATUSES,
    DeviceEnd,
    Drilled,
    DrillFinding,
    PlannedDrill,
    PlannedRehearsal,
    end_faults,
)
from leactl.runner.dry_run import dry_run
from leactl.runner.operators import confirm_at_once, keyboard
from leactl.runner.outcome import Outcome
from leactl.runner.request import Request, prepare_by_hand
from leactl.runner.session import execute

MOST_CURRENT_A, MOST_VELOCITY_RAD_S = 1.0, 1.0  # or a twentieth of the bench's limits if that is less
STOP_AFTER_S = 1.0  # from the first cycle to the stop request
TIME_TO_ACT_S = 30.0  # in which a person has to press the key or to unplug the sensor
KEY_REASON = "stopped by the operator: key"  # beginning of the reason of a run that a key has stopped
STOP, KEY, UNPLUGGED, DEAD_MAN = "stop", "operator_stop", "sensor_unplugged", "dead_man"
EXERCISE_NAMES = (STOP, KEY, UNPLUGGED, DEAD_MAN)


@dataclass(frozen=True)
class Person:
    """Functions by which the drill talks to the person at the bench."""

    agrees: Callable[[str], bool]  # shows a rehearsal and returns whether the person agrees to it
    tell: Callable[[str], None]
    present: bool  # whether somebody is at a terminal, who can press a key and unplug a sensor


class _Exercise(NamedTuple):
    """One rehearsal that this drill can make, by one run."""

    name: str
    explained: str  # what happens in it, for a person
    needs_person: bool
    steps: Sequence[str]  # of its run, in YAML
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
        """Choose the rehearsals, and the setpoints of their runs.

        Parameters
        ----------
        bench : name of a shipped bench, or path of a bench file.
        only : names of the rehearsals to make; empty: all.
        directory : of the run files.
        served : whether another process emulates the bench, on real buses.
        buses : changes of buses, as `changed_buses` takes them.

        Raises
        ------
        InputError : no such bench, a name in `only` that is not in EXERCISE_NAMES, or no drive that could be moved.
        """
        self._file, devices, _document = benchfile.load(bench)
        unknown = [name for name in only if name not in EXERCISE_NAMES]
        if unknown:
            known = f"known on a real bench: {', '.join(EXERCISE_NAMES)}"
            raise InputError([f"--only {name}: no fault can be put into a real bench; {known}" for name in unknown])
        self._bench, self._directory, self._person = bench, directory, person
        self._served, self._buses = served, buses
        self._only = set(only) or set(EXERCISE_NAMES)
        roles = drives(devices)
        self._setup = setup_of(self._file, roles)
        limits = self._file.limits
        self._velocity = min(MOST_VELOCITY_RAD_S, 0.05 * limits.velocity_rad_s)
        self._current = min(MOST_CURRENT_A, 0.05 * limits.current_A)
        self._roles = roles.values()
        self._motion_steps(TIME_TO_ACT_S)  # raises InputError if no drive could be moved
        sensors = (device.name for device in devices if hasattr(registry.load(device.entry.driver), "tare"))
        self._sensor = next(sensors, "")
        silences = benchfile.host_silences(devices)
        self._silence_s = max((silence for silence in silences.values() if silence), default=0.0)

    def run(self) -> Drilled:
        """Make the rehearsals one after the other; the one that latches the bench comes last.

        Raises
        ------
        Stopped, SafetyTrip, DeviceError, RecordingFailed : as for any run.
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
        return Drilled(self._file.name, False, findings, left_out | self._faults_left_out)

    def planned(self) -> PlannedDrill:
        """Return what `run` would rehearse if a person agreed to all of it; no device is opened.

        Raises
        ------
        InputError, SafetyTrip, DeviceError : as for any run, before a device is opened.
        """
        left_out = self._left_out()
        planned_rehearsals = []
        devices: list[str] = []
        for exercise in self._exercises():
            if exercise.name not in left_out:
                request = self._request(exercise.steps)
                devices = [device.name for device in request.devices]  # the same for each run
                plan = dry_run(request).plan
                on = self._sensor if exercise.name == UNPLUGGED else ""
                planned_rehearsals.append(PlannedRehearsal(exercise.name, on, exercise.explained, plan))
        return PlannedDrill(self._file.name, False, devices, planned_rehearsals, left_out | self._faults_left_out)

    def _exercises(self) -> list[_Exercise]:
        """Return the chosen rehearsals; the one that latches the bench comes last."""
        motion = f"at {self._velocity:g} rad/s and {self._current:g} A at the most; keep clear of the shaft"
        stop_text = f"The drives move for {STOP_AFTER_S:g} s and are stopped, {motion}."
        key_text = f"The drives move until you press space or q, {motion}."
        unplug_text = f"Drives off; you unplug {self._sensor} and the bench has to trip. It stays latched afterwards."
        stop_steps, key_steps = self._motion_steps(STOP_AFTER_S + TIME_TO_ACT_S), self._motion_steps(TIME_TO_ACT_S)
        reading_steps = by_hand.reading_steps(TIME_TO_ACT_S)
        exercises = (
            _Exercise(STOP, stop_text, False, stop_steps, self._rehearse_stop),
            _Exercise(KEY, key_text, True, key_steps, self._rehearse_key),
            _Exercise(UNPLUGGED, unplug_text, True, reading_steps, self._rehearse_unplugging),
        )
        return [exercise for exercise in exercises if exercise.name in self._only]

    def _left_out(self) -> dict[str, str]:
        """Return the chosen rehearsals that cannot be made here: the reason of each, by name."""
        left_out = {DEAD_MAN: self._dead_man_instructions} if DEAD_MAN in self._only else {}
        for exercise in self._exercises():
            if exercise.name == UNPLUGGED and not self._sensor:
                left_out[exercise.name] = "no sensor on an analogue input"
            elif exercise.needs_person and not self._person.present:
                left_out[exercise.name] = "it takes a person at a terminal"
        return left_out

    @property
    def _faults_left_out(self) -> dict[str, str]:
        """The reason why the faults of the catalogue are not rehearsed."""
        return {f"{len(known_faults())} faults of the catalogue": "no fault can be put into a real bench"}

    @property
    def _dead_man_instructions(self) -> str:
        """Instructions to test the dead-man by hand, since a run cannot and should not stop sending to a drive."""
        return (
            f"nothing here lets a drive starve; by hand: `leactl bench jog {self._bench} --current 0 --for 20`,"
            f" `kill -9` of its process, and the drive's own display: out of operation within {self._silence_s:g} s"
        )

    def _motion_steps(self, hold_s: float) -> list[str]:
        """Return steps that move the drives, with a hold of this duration [s]."""
        return by_hand.motion_steps(self._setup, self._roles, self._velocity, self._current, hold_s)

    def _rehearse_stop(self) -> DrillFinding:
        """Make a run that is asked to stop after `STOP_AFTER_S`, and judge the time to its safe state."""
        cycle_times: list[float] = []
        stop_times: list[float] = []

        def stop_after_delay() -> str:
            cycle_times.append(time.monotonic())
            if cycle_times[-1] - cycle_times[0] < STOP_AFTER_S:
                return ""
            stop_times.append(cycle_times[-1])
            return STOP_REASON

        outcome, safe_at = self._run(
            self._motion_steps(STOP_AFTER_S + TIME_TO_ACT_S), [stop_after_delay], expected_reason=STOP_REASON
        )
        reaction_s = safe_at - stop_times[0] if stop_times else None
        return self._finding(STOP, "", "the stop request", SAFE_STATE_S, outcome, ["stopped"], reaction_s)

    def _rehearse_key(self) -> DrillFinding:
        """Make a run that a person stops by a key, and judge it."""
        with keyboard(shown=True) as keys:
            instruction = f"Press space or q now: {TIME_TO_ACT_S:g} s are left."
            steps = self._motion_steps(TIME_TO_ACT_S)
            outcome, _safe_at = self._run(steps, [keys.pressed], instruction, KEY_REASON)
        return self._finding(KEY, "", "the operator's key", None, outcome, ["stopped"], None)

    def _rehearse_unplugging(self) -> DrillFinding:
        """Make a run with the drives off, in which a person unplugs the sensor, and judge whether the bench trips."""
        instruction = f"Unplug {self._sensor} now: {TIME_TO_ACT_S:g} s are left."
        outcome, _safe_at = self._run(by_hand.reading_steps(TIME_TO_ACT_S), [], instruction)
        return self._finding(
            UNPLUGGED, self._sensor, "an interlock or the device itself", None, outcome, CAUGHT_STATUSES, None
        )

    def _run(
        self, steps: Sequence[str], stops: Sequence[Callable[[], str]], instruction: str = "", expected_reason: str = ""
    ) -> tuple[Outcome, float]:
        """Make one run; return its outcome and the `time.monotonic` at which its devices were safe [s].

        Parameters
        ----------
        stops : asked once a cycle for a reason to stop the run; an empty text lets it go on.
        instruction : told to the person when the run begins.

        Raises
        ------
        Stopped : the run was stopped, and its reason does not begin with `expected_reason`.
        """
        request = self._request(steps)
        safe_at: list[float] = []

        @contextmanager
        def watch(_progress: object) -> Iterator[None]:
            if instruction:
                self._person.tell(instruction)
            yield
            safe_at.append(time.monotonic())

        outcome = execute(request, confirm_at_once, watch, stops)
        if isinstance(outcome.error, Stopped) and not (expected_reason and outcome.reason.startswith(expected_reason)):
            raise outcome.error
        # where the instruction could not be told, the view never began: a later moment, which no drill passes wrongly
        return outcome, safe_at[0] if safe_at else time.monotonic()

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
        allowed_statuses: Sequence[str],
        reaction_s: float | None,
    ) -> DrillFinding:
        """Return the finding, with the faults of the run's end, its reaction time and its run file."""
        ends = {device: DeviceEnd(end.safe, end.detail, None) for device, end in outcome.safe.items()}
        if name == UNPLUGGED:  # an unplugged sensor cannot confirm anything, and has no power
            ends.pop(on, None)
        faults = end_faults(outcome, allowed_statuses, ends)
        if reaction_s is not None and within_s is not None and reaction_s > within_s:
            faults.append(f"safe after {reaction_s:.2f} s; {within_s:g} s were expected")
        faults += [f"run file: {text}" for text in verify(outcome.path)]
        latched = latch.tripped_latches(self._bench)
        notes = [f"the bench is latched: leactl bench reset {self._bench}"] if latched else []
        return DrillFinding(
            name,
            on,
            {},
            ought,
            within_s,
            outcome.status,
            outcome.reason,
            reaction_s,
            None,
            ends,
            faults,
            notes,
            str(outcome.path),
        )
