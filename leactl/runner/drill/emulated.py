"""Rehearses the catalogue of faults on an emulated bench, a short run each, and judges by the plant itself.

The runs go the way of every run. Their latches and locks are in a state directory of their own, so that those of the
person who drills are left alone.
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
from leactl.protocol import by_hand
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner.drill.finding import (
    CAUGHT,
    DeviceEnd,
    Drilled,
    DrillFinding,
    PlannedDrill,
    PlannedRehearsal,
    Tell,
    of_the_end,
)
from leactl.runner.drill.power_watch import DrivePowerWatch
from leactl.runner.dry_run import dry_run
from leactl.runner.operators import granted
from leactl.runner.outcome import Outcome
from leactl.runner.request import prepare_by_hand
from leactl.runner.session import execute
from leactl.runner.signals import between_runs

MOST_CURRENT_A, MOST_VELOCITY_RAD_S = 4.0, 5.0  # or a quarter of the bench's limits
BEFORE_S, AFTER_S = 0.3, 0.2  # of the held step, before the fault and beyond the latest moment to notice it
CYCLE_S = 1 / by_hand.RATE_HZ
NOTHING, STOP = "no_fault", "stop"
STOPPED = "stopped by the drill"


@dataclass(frozen=True)
class _Ended:
    """One run and what its plant shows."""

    outcome: Outcome
    plant: DrivePowerWatch
    ends: Mapping[str, DeviceEnd]
    file_faults: list[str]


class EmulatedDrill:
    """The drill of one emulated bench."""

    def __init__(self, bench: str, only: Collection[str], directory: Path, tell: Tell) -> None:
        """Check what is to be rehearsed.

        Raises
        ------
        InputError : no such bench or fault, a bench that is not emulated, or no drive that could be moved.
        """
        self._file, devices, self._document = benchfile.load(bench)
        if self._file.emulated is None:
            raise InputError(f"bench '{self._file.name}' is not emulated: no fault can be put into it")
        faults = [name for name in only if name not in (NOTHING, STOP)]
        self._rehearsals, self._left_out = ([], {}) if only and not faults else rehearsals(self._file, devices, faults)
        self._stops = not only or STOP in only
        self._directory, self._tell = directory, tell
        self._roles = drives(devices)
        longest = max([item.drill.within_s for item in self._rehearsals], default=0.5)
        self._setup = setup_of(self._file, self._roles)
        self._steps = by_hand.motion_steps(
            self._setup,
            self._roles.values(),
            min(MOST_VELOCITY_RAD_S, 0.25 * self._file.limits.velocity_rad_s),
            min(MOST_CURRENT_A, 0.25 * self._file.limits.current_A),
            round(BEFORE_S + longest + AFTER_S, 3),
        )

    def planned(self) -> PlannedDrill:
        """Return what `run` would rehearse.

        Raises
        ------
        InputError, SafetyTrip : plan and bench do not fit, or the bench is latched.
        """
        request = prepare_by_hand("drill", self._steps, self._document.name, self._setup, self._directory, False)
        with _own_state():
            plan = dry_run(request).plan
        rehearsed = [(NOTHING, "", "nothing goes wrong")]
        rehearsed += [(STOP, "", "the run is stopped")] if self._stops else []
        rehearsed += [(item.fault, item.on, f"ought to be ended by: {item.drill.by}") for item in self._rehearsals]
        planned = [PlannedRehearsal(name, on, explained, plan) for name, on, explained in rehearsed]
        devices = [device.name for device in request.devices]
        return PlannedDrill(self._file.name, True, devices, planned, self._left_out)

    def run(self) -> Drilled:
        """Rehearse one after the other.

        Raises
        ------
        Stopped : a person stopped it; what was rehearsed until then is lost.
        DeviceError, RecordingFailed : as of any run.
        """
        count = 1 + self._stops + len(self._rehearsals)
        with between_runs() as check:
            self._tell(NOTHING, 0, count)
            first, moment = self._without_fault()
            if not first.held:
                untried = dict.fromkeys((item.fault for item in self._rehearsals), "a run without a fault did not pass")
                return Drilled(self._file.name, True, [first], untried)
            findings = [first]
            if self._stops:
                check()
                self._tell(STOP, 1, count)
                findings.append(self._stopped(moment))
            for item in self._rehearsals:
                check()
                self._tell(" ".join(filter(None, (item.fault, item.on))), len(findings), count)
                findings.append(self._rehearsed(item, moment, len(findings)))
            check()
        return Drilled(self._file.name, True, findings, self._left_out)

    def _without_fault(self) -> tuple[DrillFinding, float]:
        """A run in which nothing goes wrong, and the moment of the bench's time at which something may."""
        ended = self._run(NOTHING, [])
        faults = [*of_the_end(ended.outcome, ["complete"], ended.ends), *ended.file_faults]
        moment = 0.0
        if not faults:
            with Run.open(ended.outcome.path) as run:
                held = next(step for step in run.steps if step.name == by_hand.HELD)
            # amid a cycle: the one after it is the first that can notice
            moment = round(ended.plant.began + held.start + BEFORE_S + 0.5 * CYCLE_S, 6)
        return self._finding(NOTHING, "", {}, "nothing", None, ended, None, faults), moment

    def _stopped(self, moment: float) -> DrillFinding:
        ended = self._run(STOP, [], stop_at=moment)
        faults = [*of_the_end(ended.outcome, ["stopped"], ended.ends), *ended.file_faults]
        return self._finding(STOP, "", {}, "the stop request", CYCLE_S, ended, moment, faults)

    def _rehearsed(self, item: FaultRehearsal, moment: float, number: int) -> DrillFinding:
        ended = self._run(f"{number:02d}-{item.fault}", [dict(item.entry) | {"at_s": moment}])
        drill = item.drill
        faults = of_the_end(ended.outcome, CAUGHT, ended.ends, item.on if drill.stays_on else "")
        late = ended.plant.cycle - moment
        if ended.outcome.status in CAUGHT and late > drill.within_s:
            faults.append(f"caught after {late:.2f} s; {drill.within_s:g} s were expected")
        faults += ended.file_faults
        notes = [
            f"{name} keeps its power until its supply is switched off, as was told"
            for name, end in ended.ends.items()
            if drill.stays_on and end.without_power is False and not end.confirmed
        ]
        return self._finding(
            item.fault, item.on, item.parameters, drill.by, drill.within_s, ended, moment, faults, notes
        )

    def _finding(
        self,
        name: str,
        on: str,
        parameters: Mapping[str, Any],
        ought: str,
        within_s: float | None,
        ended: _Ended,
        moment: float | None,
        faults: list[str],
        notes: list[str] | None = None,
    ) -> DrillFinding:
        outcome, plant = ended.outcome, ended.plant
        noticed = moment is not None and outcome.status != "complete"
        since = moment or 0.0
        zero = plant.unpowered_since
        return DrillFinding(
            name,
            on,
            parameters,
            ought,
            within_s,
            outcome.status,
            outcome.reason,
            round(plant.cycle - since, 6) if noticed else None,
            round(zero - since, 6) if noticed and zero is not None else None,
            ended.ends,
            faults,
            notes or [],
            str(outcome.path),
        )

    def _run(self, name: str, faults: list[dict[str, Any]], stop_at: float | None = None) -> _Ended:
        """One run of the bench file with these faults instead of its own; the file is kept beside the run's."""
        written = self._directory / f"{name}.yaml"
        data = self._document.data
        data = data | {"emulated": {**data["emulated"], "faults": faults}}
        written.write_text(yaml.dump(data, Dumper=_Plain, sort_keys=False, allow_unicode=True), encoding="utf-8")
        request = prepare_by_hand("drill", self._steps, str(written), self._setup, self._directory, realtime=False)
        plant = DrivePowerWatch()

        def begin(_progress: object) -> nullcontext[None]:
            plant.began = plant.bench.time.now()
            return nullcontext()

        def each_cycle() -> str:
            plant.cycle = plant.bench.time.now()
            return STOPPED if stop_at is not None and plant.cycle >= stop_at else ""

        with _own_state(), observed(plant.see):
            outcome = execute(request, granted, begin, [each_cycle])
        if isinstance(outcome.error, Stopped) and outcome.reason != STOPPED:
            raise outcome.error
        plant.end()
        ends = {
            name: DeviceEnd(
                confirmation.safe,
                confirmation.detail,
                not plant.powered(self._roles[name]) if name in self._roles else None,
            )
            for name, confirmation in outcome.safe.items()
        }
        return _Ended(outcome, plant, ends, [f"run file: {text}" for text in verify(outcome.path)])


class _Plain(yaml.SafeDumper):
    """Writes what `leactl.yamlfile` reads: no anchors."""

    def ignore_aliases(self, _data: Any) -> bool:
        """Whatever stands twice is written twice."""
        return True


def drives(devices: Collection[CheckedDevice]) -> dict[str, str]:
    """Names of the drives of a bench and their roles."""
    return {
        device.name: device.entry.role for device in devices if hasattr(registry.load(device.entry.driver), "engage")
    }


def setup_of(file: BenchFile, roles: Mapping[str, str]) -> str:
    """The bench's own set-up; where it names none, coupled if there is a drive at either end."""
    return file.setup or ("coupled" if len(roles) > 1 else "free")


@contextmanager
def _own_state() -> Iterator[None]:
    """Have latches, locks and runs under way kept apart until the block is left."""
    before = os.environ.get("LEACTL_STATE")
    with tempfile.TemporaryDirectory(prefix="leactl-drill-") as place:
        os.environ["LEACTL_STATE"] = place
        try:
            yield
        finally:
            if before is None:
                del os.environ["LEACTL_STATE"]
            else:
                os.environ["LEACTL_STATE"] = before
