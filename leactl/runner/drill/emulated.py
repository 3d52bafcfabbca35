"""Rehearse each fault of the catalogue in a short run on an emulated bench, and judge it by the emulated plant itself.

The runs are executed as any other run. Their latches and locks are in a temporary state directory, so that those of the
user are neither read nor changed.
"""

import os
import tempfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from leactl.bench import benchfile
from leactl.bench.benchfile import BenchFile, CheckedDevice
from leactl.driver import registry
from leactl.emulation.bench.emulated_bench import observed
from leactl.emulation.faults.drilling import FaultRehearsal, rehearsals
from leactl.errors import InputError, Stopped
from leactl.model.motor import motor_names
from leactl.protocol import by_hand
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner.drill.finding import (
    CAUGHT_STATUSES,
    DeviceEnd,
    Drilled,
    DrillFinding,
    PlannedDrill,
    PlannedRehearsal,
    Tell,
    end_faults,
)
from leactl.runner.drill.power_watch import DrivePowerWatch
from leactl.runner.dry_run import dry_run
from leactl.runner.operators import confirm_at_once
from leactl.runner.outcome import Outcome
from leactl.runner.request import prepare_by_hand
from leactl.runner.session import execute
from leactl.runner.stop_requests import between_runs

MOST_CURRENT_A, MOST_VELOCITY_RAD_S = 4.0, 5.0  # or a quarter of the bench's limits if that is less
HELD_BEFORE_S = 0.3  # from the start of the held step to the fault
HELD_AFTER_S = 0.2  # from the latest allowed reaction to the end of the held step
CYCLE_S = 1 / by_hand.RATE_HZ
NO_FAULT, STOP = "no_fault", "stop"  # names of the two rehearsals without a fault of the catalogue
STOP_REASON = "stopped by the drill"


@dataclass(frozen=True)
class _RehearsedRun:
    """The run of one rehearsal, with its end as the emulated plant shows it."""

    outcome: Outcome
    power_watch: DrivePowerWatch
    ends: Mapping[str, DeviceEnd]
    file_faults: list[str]  # of the run file


class EmulatedDrill:
    """The drill of one emulated bench."""

    def __init__(self, bench: str, only: Collection[str], directory: Path, tell: Tell) -> None:
        """Choose the rehearsals, and the steps that each of their runs takes.

        Parameters
        ----------
        bench : name of a shipped bench, or path of a bench file.
        only : names of the faults to rehearse, `stop` among them; empty: all. A run without a fault is always made.
        directory : of the run files and the changed bench files.
        tell : shows progress.

        Raises
        ------
        InputError : no such bench or fault, a bench that is not emulated, or no drive that could be moved.
        """
        self._file, devices, self._document = benchfile.load(bench)
        if self._file.emulated is None:
            raise InputError(f"bench '{self._file.name}' is not emulated: no fault can be put into it")
        faults = [name for name in only if name not in (NO_FAULT, STOP)]
        self._rehearsals, self._left_out = ([], {}) if only and not faults else rehearsals(self._file, devices, faults)
        self._stops = not only or STOP in only
        self._directory, self._tell = directory, tell
        self._roles = drives(devices)
        longest = max([rehearsal.drill.within_s for rehearsal in self._rehearsals], default=0.5)
        self._setup = setup_of(self._file, self._roles)
        self._steps = by_hand.motion_steps(
            self._setup,
            self._roles.values(),
            min(MOST_VELOCITY_RAD_S, 0.25 * self._file.limits.velocity_rad_s),
            min(MOST_CURRENT_A, 0.25 * self._file.limits.current_A),
            round(HELD_BEFORE_S + longest + HELD_AFTER_S, 3),
        )

    def planned(self) -> PlannedDrill:
        """Return what `run` would rehearse.

        Raises
        ------
        InputError, SafetyTrip : plan and bench do not fit, or the bench is latched.
        """
        request = prepare_by_hand("drill", self._steps, self._document.name, self._setup, self._directory, False)
        with _temporary_state():
            plan = dry_run(request).plan
        rehearsed = [(NO_FAULT, "", "nothing goes wrong")]
        rehearsed += [(STOP, "", "the run is stopped")] if self._stops else []
        rehearsed += [
            (rehearsal.fault, rehearsal.on, f"ought to be ended by: {rehearsal.drill.ended_by}")
            for rehearsal in self._rehearsals
        ]
        planned_rehearsals = [PlannedRehearsal(name, on, explained, plan) for name, on, explained in rehearsed]
        devices = [device.name for device in request.devices]
        return PlannedDrill(self._file.name, True, devices, planned_rehearsals, self._left_out)

    def run(self) -> Drilled:
        """Make all rehearsals one after the other.

        Raises
        ------
        Stopped : a person stopped the drill; the findings until then are lost.
        DeviceError, RecordingFailed : as for any run.
        """
        count = 1 + self._stops + len(self._rehearsals)
        with between_runs() as check:
            self._tell(NO_FAULT, 0, count)
            no_fault, fault_time = self._rehearse_no_fault()
            if not no_fault.held:
                reason = "a run without a fault did not pass"
                not_rehearsed = dict.fromkeys((rehearsal.fault for rehearsal in self._rehearsals), reason)
                return Drilled(self._file.name, True, [no_fault], not_rehearsed)
            findings = [no_fault]
            if self._stops:
                check()
                self._tell(STOP, 1, count)
                findings.append(self._rehearse_stop(fault_time))
            for rehearsal in self._rehearsals:
                check()
                self._tell(" ".join(filter(None, (rehearsal.fault, rehearsal.on))), len(findings), count)
                findings.append(self._rehearse_fault(rehearsal, fault_time, len(findings)))
            check()
        return Drilled(self._file.name, True, findings, self._left_out)

    def _rehearse_no_fault(self) -> tuple[DrillFinding, float]:
        """Make a run without a fault; return its finding, and the time of the fault or stop in later runs [s].

        The time is by the bench's clock; it is 0 if the run has faults.
        """
        rehearsed = self._run(NO_FAULT, [])
        faults = [*end_faults(rehearsed.outcome, ["complete"], rehearsed.ends), *rehearsed.file_faults]
        fault_time = 0.0
        if not faults:
            with Run.open(rehearsed.outcome.path) as run:
                held_step = next(step for step in run.steps if step.name == by_hand.HOLD_NAME)
            # half a cycle later, so that it is clear which cycle is the first that can notice the fault
            fault_time = round(rehearsed.power_watch.run_start + held_step.start + HELD_BEFORE_S + 0.5 * CYCLE_S, 6)
        return self._finding(NO_FAULT, "", {}, "nothing", None, rehearsed, None, faults), fault_time

    def _rehearse_stop(self, stop_time: float) -> DrillFinding:
        """Make a run that is asked to stop at this time by the bench's clock [s], and judge it."""
        rehearsed = self._run(STOP, [], stop_at=stop_time)
        faults = [*end_faults(rehearsed.outcome, ["stopped"], rehearsed.ends), *rehearsed.file_faults]
        return self._finding(STOP, "", {}, "the stop request", CYCLE_S, rehearsed, stop_time, faults)

    def _rehearse_fault(self, rehearsal: FaultRehearsal, fault_time: float, number: int) -> DrillFinding:
        """Make a run with a fault at this time by the bench's clock [s], and judge it.

        Parameters
        ----------
        number : of the rehearsal in the drill, for the name of its bench file.
        """
        rehearsed = self._run(f"{number:02d}-{rehearsal.fault}", [dict(rehearsal.entry) | {"at_s": fault_time}])
        drill = rehearsal.drill
        stays_on = rehearsal.on if drill.stays_on else ""
        faults = end_faults(rehearsed.outcome, CAUGHT_STATUSES, rehearsed.ends, stays_on)
        reaction_s = rehearsed.power_watch.last_cycle - fault_time
        if rehearsed.outcome.status in CAUGHT_STATUSES and reaction_s > drill.within_s:
            faults.append(f"caught after {reaction_s:.2f} s; {drill.within_s:g} s were expected")
        faults += rehearsed.file_faults
        notes = [
            f"{name} keeps its power until its supply is switched off, as was told"
            for name, end in rehearsed.ends.items()
            if drill.stays_on and end.without_power is False and not end.confirmed
        ]
        return self._finding(
            rehearsal.fault,
            rehearsal.on,
            rehearsal.parameters,
            drill.ended_by,
            drill.within_s,
            rehearsed,
            fault_time,
            faults,
            notes,
        )

    def _finding(
        self,
        name: str,
        on: str,
        parameters: Mapping[str, Any],
        ought: str,
        within_s: float | None,
        rehearsed: _RehearsedRun,
        event_time: float | None,  # of the fault or stop, s on the bench's clock
        faults: list[str],
        notes: list[str] | None = None,
    ) -> DrillFinding:
        """Return the finding, with the times from the event to the last cycle and to the loss of all power."""
        outcome, power_watch = rehearsed.outcome, rehearsed.power_watch
        noticed = event_time is not None and outcome.status != "complete"
        start = event_time or 0.0
        unpowered_since = power_watch.unpowered_since
        return DrillFinding(
            name,
            on,
            parameters,
            ought,
            within_s,
            outcome.status,
            outcome.reason,
            round(power_watch.last_cycle - start, 6) if noticed else None,
            round(unpowered_since - start, 6) if noticed and unpowered_since is not None else None,
            rehearsed.ends,
            faults,
            notes or [],
            str(outcome.path),
        )

    def _run(self, name: str, faults: list[dict[str, Any]], stop_at: float | None = None) -> _RehearsedRun:
        """Make one run with these faults instead of the bench file's, from a changed bench file beside the run file.

        Parameters
        ----------
        faults : entries of `emulated.faults` in the bench file.
        stop_at : time by the bench's clock at which the run is asked to stop [s]; None: it is not.
        """
        bench_path = self._directory / f"{name}.yaml"
        data = self._document.data
        data = data | {"emulated": {**data["emulated"], "faults": faults}}
        assert self._file.emulated is not None
        for block, motors in ((data, self._file.motors), (data["emulated"], self._file.emulated.motors)):
            if motors:  # the copy is in another folder than the bench file
                block["motors"] = {
                    role: name if name in motor_names() else str(Path(name).absolute()) for role, name in motors.items()
                }
        bench_path.write_text(yaml.dump(data, Dumper=_Plain, sort_keys=False, allow_unicode=True), encoding="utf-8")
        request = prepare_by_hand("drill", self._steps, str(bench_path), self._setup, self._directory, realtime=False)
        power_watch = DrivePowerWatch()

        def record_start(_progress: object) -> nullcontext[None]:
            power_watch.run_start = power_watch.bench.time.now()
            return nullcontext()

        def stop_source() -> str:
            power_watch.last_cycle = power_watch.bench.time.now()
            return STOP_REASON if stop_at is not None and power_watch.last_cycle >= stop_at else ""

        with _temporary_state(), observed(power_watch.see):
            outcome = execute(request, confirm_at_once, record_start, [stop_source])
        if isinstance(outcome.error, Stopped) and outcome.reason != STOP_REASON:
            raise outcome.error
        power_watch.end()
        ends = {
            name: DeviceEnd(
                confirmation.safe,
                confirmation.detail,
                not power_watch.powered(self._roles[name]) if name in self._roles else None,
            )
            for name, confirmation in outcome.safe.items()
        }
        return _RehearsedRun(outcome, power_watch, ends, [f"run file: {text}" for text in verify(outcome.path)])


class _Plain(yaml.SafeDumper):
    """Writes YAML without anchors, because `leactl.yamlfile` does not read them."""

    def ignore_aliases(self, _data: Any) -> bool:
        """Return True: an object that occurs twice is written twice."""
        return True


def drives(devices: Collection[CheckedDevice]) -> dict[str, str]:
    """Return the role of each drive of a bench, by the name of the drive."""
    return {
        device.name: device.entry.role for device in devices if hasattr(registry.load(device.entry.driver), "engage")
    }


def setup_of(file: BenchFile, roles: Mapping[str, str]) -> str:
    """Return the set-up of the bench file; if it has none, `coupled` for two drives and `free` for fewer."""
    return file.setup or ("coupled" if len(roles) > 1 else "free")


@contextmanager
def _temporary_state() -> Iterator[None]:
    """Keep latches, locks and the list of runs under way in a temporary directory until the block is left."""
    previous = os.environ.get("LEACTL_STATE")
    with tempfile.TemporaryDirectory(prefix="leactl-drill-") as directory:
        os.environ["LEACTL_STATE"] = directory
        try:
            yield
        finally:
            if previous is None:
                del os.environ["LEACTL_STATE"]
            else:
                os.environ["LEACTL_STATE"] = previous
