"""The plan and the result of a drill: for each rehearsal, what ended its run, after what time, and in which state."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from leactl.protocol.plan import Plan
from leactl.runner.outcome import Outcome

CAUGHT_STATUSES = ("tripped", "failed")  # of a run that a fault has ended

Tell = Callable[[str, int, int], None]
"""Shows progress, from the name of the next rehearsal, the number of rehearsals done, and the number of all."""


@dataclass(frozen=True)
class PlannedRehearsal:
    """One rehearsal that a drill would make now."""

    name: str  # of the fault, or of the action of a person
    on: str  # name of the device or bus with the fault
    explained: str  # what happens in it, for a person
    plan: Plan  # of its run, which may end early


@dataclass(frozen=True)
class PlannedDrill:
    """The plan of a whole drill, made without moving anything."""

    bench: str
    emulated: bool
    devices: Sequence[str]  # names of the devices that would be opened
    rehearsals: Sequence[PlannedRehearsal]
    left_out: Mapping[str, str]  # names of faults that would not be rehearsed: why


@dataclass(frozen=True)
class DeviceEnd:
    """The state of a device after a run, as it reports it and as the emulated bench shows it."""

    confirmed: bool  # whether its safe state is confirmed
    detail: str  # text of the confirmation
    without_power: bool | None  # of an emulated drive; None for any other device


@dataclass(frozen=True)
class DrillFinding:
    """The result of one rehearsal."""

    name: str  # of the fault, or of the action of a person
    on: str  # name of the device or bus with the fault
    parameters: Mapping[str, Any]
    ought: str  # what ought to end the run
    within_s: float | None  # longest allowed time from the fault or stop
    status: str  # of the run
    reason: str
    # time from the fault or stop to the cycle that ended the run, on a real bench to the safe state; None: not known
    ended_s: float | None
    zero_torque_s: float | None  # time from the fault to no power at any emulated drive; None: unknown, or never
    devices: Mapping[str, DeviceEnd]
    faults: Sequence[str]  # of the end of its run, of the reaction time and of the run file; one line each
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
    left_out: Mapping[str, str] = field(default_factory=dict)  # names of faults that were not rehearsed: why

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
    outcome: Outcome, allowed_statuses: Sequence[str], device_ends: Mapping[str, DeviceEnd], stays_on: str = ""
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
    for name, device_end in device_ends.items():
        if device_end.without_power is False and device_end.confirmed:
            faults.append(f"{name} was confirmed safe and has power")
        elif device_end.without_power is False and name != stays_on:
            faults.append(f"{name} was left with power")
        elif device_end.without_power is None and not device_end.confirmed:
            faults.append(f"{name} not confirmed safe: {device_end.detail}")
    return faults
