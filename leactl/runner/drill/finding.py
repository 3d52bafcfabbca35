"""What a drill would do, and what it found: of each rehearsal how it was noticed, how fast, how the bench ended."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from leactl.protocol.plan import Plan
from leactl.runner.outcome import Outcome

CAUGHT = ("tripped", "failed")

Tell = Callable[[str, int, int], None]
"""Takes what is rehearsed next, how many have been, and how many there are."""


@dataclass(frozen=True)
class PlannedRehearsal:
    """One rehearsal that a drill would make now."""

    name: str  # of the fault, or of what a person does
    on: str  # device or bus
    explained: str  # what happens
    plan: Plan  # of its run, which the rehearsal may end early


@dataclass(frozen=True)
class PlannedDrill:
    """A whole drill that nothing has been moved for."""

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
    """One rehearsal."""

    name: str  # of the fault, or of what a person does
    on: str  # device or bus
    parameters: Mapping[str, Any]
    ought: str  # what ought to end the run
    within_s: float | None  # from its beginning
    status: str  # of the run
    reason: str
    ended_s: float | None  # from its beginning to the cycle that ended the run
    zero_torque_s: float | None  # to no torque at any emulated drive; None: unknown, or never
    devices: Mapping[str, DeviceEnd]
    faults: Sequence[str]  # what was not as it ought to be
    notes: Sequence[str] = ()
    run: str = ""  # its file, where it is kept

    @property
    def held(self) -> bool:
        """Whether all was as it ought to be."""
        return not self.faults


@dataclass(frozen=True)
class Drilled:
    """A whole drill."""

    bench: str
    emulated: bool
    findings: Sequence[DrillFinding]
    left_out: Mapping[str, str] = field(default_factory=dict)  # what was not rehearsed, and why

    @property
    def held(self) -> bool:
        """Whether everything that ought to be caught was, and every end was safe."""
        return all(finding.held for finding in self.findings)

    def told(self) -> dict[str, Any]:
        """As `--json` tells it."""
        findings = [asdict(finding) | {"held": finding.held} for finding in self.findings]
        left_out = [{"name": name, "why": why} for name, why in self.left_out.items()]
        return {
            "bench": self.bench,
            "emulated": self.emulated,
            "held": self.held,
            "findings": findings,
            "not_rehearsed": left_out,
        }


def of_the_end(outcome: Outcome, wanted: Sequence[str], ends: Mapping[str, DeviceEnd], stays_on: str = "") -> list[str]:
    """What of the end of a run was not as it ought to be.

    Parameters
    ----------
    wanted : the statuses that it may have.
    stays_on : a device that nothing but its supply takes the power from.
    """
    faults = []
    if outcome.status not in wanted:
        faults.append("not caught" if outcome.status == "complete" else f"{outcome.status}: {outcome.reason}")
    for name, end in ends.items():
        if end.without_power is False and end.confirmed:
            faults.append(f"{name} was confirmed safe and has power")
        elif end.without_power is False and name != stays_on:
            faults.append(f"{name} was left with power")
        elif end.without_power is None and not end.confirmed:
            faults.append(f"{name} not confirmed safe: {end.detail}")
    return faults
