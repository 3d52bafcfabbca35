"""The plan and the result of a drill: for each rehearsal what ended its run, how fast, and how each device ended."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from leactl.protocol.plan import Plan
from leactl.runner.outcome import Outcome

CAUGHT_STATUSES = ("tripped", "failed")  # of a run that a fault has ended

Tell = Callable[[str, int, int], None]
"""Shows progress: the name of the next rehearsal, the number of those done, and the number of all."""


@dataclass(frozen=True)
class PlannedRehearsal:
    """One rehearsal that a drill would make now."""

    name: str  # of the fault, or of what a person does
    on: str  # device or bus
    explained: str  # what happens
    plan: Plan  # of its run, which the rehearsal may end early


@dataclass(frozen=True)
class PlannedDrill:
    """The plan of a whole drill, made without moving anything."""

    bench: str
    emulated: bool
    devices: Sequence[str]  # names of those that would be opened
    rehearsals: Sequence[PlannedRehearsal]
    left_out: Mapping[str, str]  # what would not be rehearsed, and why


@dataclass(frozen=True)
class DeviceEnd:
    """How a device ended: what it confirmed, and what the emulated bench itself shows."""

    confirmed: bool
    detail: str
    without_power: bool | None  # of an emulated drive; None where nothing but the device can tell


@dataclass(frozen=True)
class DrillFinding:
    """The result of one rehearsal."""

    name: str  # of the fault, or of what a person does
    on: str  # device or bus
    parameters: Mapping[str, Any]
    ought: str  # what ought to end the run
    within_s: float | None  # longest allowed time from the fault or stop
    status: str  # of the run
    reason: str
    # time from the fault or stop to the cycle that ended the run, on a real bench to the safe state; None: not known
    ended_s: float | None
    zero_torque_s: float | None  # time from the fault to no power at any emulated drive; None: unknown, or never
    devices: Mapping[str, DeviceEnd]
    faults: Sequence[str]  # what was not as it ought to be
    notes: Sequence[str] = ()
    run: str = ""  # path of the run file; empty if the file is not kept

    @property
    def held(self) -> bool:
        """Whether the rehearsal has no fault."""
        return not self.faults


@dataclass(frozen=True)
class Drilled:
    """The result of a whole drill."""

    bench: str
    emulated: bool
    findings: Sequence[DrillFinding]
    left_out: Mapping[str, str] = field(default_factory=dict)  # what was not rehearsed, and why

    @property
    def held(self) -> bool:
        """Whether no rehearsal has a fault."""
        return all(finding.held for finding in self.findings)

    def as_json(self) -> dict[str, Any]:
        """Return the drill as the JSON object that `--json` prints."""
        findings = [asdict(finding) | {"held": finding.held} for finding in self.findings]
        left_out = [{"name": name, "why": why} for name, why in self.left_out.items()]
        return {
            "bench": self.bench,
            "emulated": self.emulated,
            "held": self.held,
            "findings": findings,
            "not_rehearsed": left_out,
        }


def end_faults(
    outcome: Outcome, allowed_statuses: Sequence[str], ends: Mapping[str, DeviceEnd], stays_on: str = ""
) -> list[str]:
    """Return the faults of a run's end: a wrong status, and devices that have power or are not confirmed safe.

    Parameters
    ----------
    allowed_statuses : the statuses that the run may end with.
    stays_on : name of a drive that only its supply can switch off: its power is a fault only if it is confirmed safe.
    """
    faults = []
    if outcome.status not in allowed_statuses:
        faults.append("not caught" if outcome.status == "complete" else f"{outcome.status}: {outcome.reason}")
    for name, end in ends.items():
        if end.without_power is False and end.confirmed:
            faults.append(f"{name} was confirmed safe and has power")
        elif end.without_power is False and name != stays_on:
            faults.append(f"{name} was left with power")
        elif end.without_power is None and not end.confirmed:
            faults.append(f"{name} not confirmed safe: {end.detail}")
    return faults
