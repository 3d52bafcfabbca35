"""The runs of a campaign as requests, every fault of theirs found before the first one begins."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from leactl.bench.benchfile import BenchFile
from leactl.errors import InputError
from leactl.protocol.plan import Prompt
from leactl.runner.campaign.campaignfile import Campaign, CampaignStep
from leactl.runner.campaign.order import Cell, drawn
from leactl.runner.dry_run import Preview, preview
from leactl.runner.request import Request, prepare
from leactl.safety.disk import COPIES, check_room, free_bytes

DIGITS = 16  # of a digest


@dataclass(frozen=True)
class CampaignEntry:
    """One run that a campaign asks for."""

    cell: Cell
    request: Request
    digest: str  # of all that determines what the run is
    step: CampaignStep

    @property
    def mounted(self) -> tuple[str, ...]:
        """What a person has to see to before it; the next run with the same needs nobody."""
        request = self.request
        return request.bench.name, request.plan.setup, self.cell.actuator, self.cell.condition, self.step.prompt

    @property
    def asks(self) -> str:
        """What the operator is asked for when it is not mounted."""
        actuator = f"actuator '{self.cell.actuator}', " if self.cell.actuator else ""
        condition = f"condition '{self.cell.condition}', " if self.cell.condition else ""
        own = f": {self.step.prompt}" if self.step.prompt else ""
        bench = self.request.bench.name
        return f"bench '{bench}': {actuator}{condition}set-up {self.request.plan.setup}, for {self.cell.step}{own}"

    @property
    def asks_within(self) -> bool:
        """Whether its protocol asks the operator too."""
        return any(isinstance(action, Prompt) for action in self.request.plan.actions)


@dataclass(frozen=True)
class Conditions:
    """What holds for every run of a campaign, as options of `leactl run`."""

    folder: Path
    operator: str = ""
    realtime: bool = False
    served: bool = False
    buses: Sequence[str] = ()


def entries_of(campaign: Campaign, conditions: Conditions) -> list[CampaignEntry]:
    """Every run of a campaign in its order, checked as `leactl run` checks it.

    Raises
    ------
    InputError : faults of protocols, benches and settings, each with its place in the campaign.
    """
    faults: list[str] = []
    prepared: dict[tuple[str, str], Request] = {}
    for step in campaign.steps.values():
        for condition in step.conditions:
            try:
                prepared[step.name, condition] = _prepared(step, condition, conditions)
            except InputError as error:
                faults += [step.fault(condition, fault) for fault in error.faults]
    if faults:
        raise InputError(list(dict.fromkeys(faults)))
    return [
        _entry(cell, campaign, prepared[cell.step, cell.condition], campaign.steps[cell.step])
        for cell in campaign.cells
    ]


def _prepared(step: CampaignStep, condition: str, told: Conditions) -> Request:
    made = prepare(
        step.protocol,
        step.bench,
        list(step.settings),
        "",
        condition,
        told.operator,
        told.folder,
        told.realtime,
        told.served,
        told.buses,
    )
    return replace(made, insert_cooldown=step.insert_cooldown)


def _entry(cell: Cell, campaign: Campaign, prepared: Request, step: CampaignStep) -> CampaignEntry:
    # repeats on an emulated bench would otherwise be the same to the last digit
    seed = drawn(f"{campaign.seed}/{cell.key}") if prepared.in_process else None
    determines = {
        "key": cell.key,
        "protocol": prepared.plan.text,
        "parameters": dict(prepared.plan.parameters),
        "bench": prepared.bench_document.text,
        "insert_cooldown": step.insert_cooldown,
        "seed": seed,
    }
    digest = sha256(json.dumps(determines, sort_keys=True).encode()).hexdigest()[:DIGITS]
    part_of = {
        "name": campaign.name,
        "variant": campaign.variant,
        "run": cell.key,
        "step": cell.step,
        "repeat": str(cell.repeat),
        "digest": digest,
    }
    return CampaignEntry(cell, replace(prepared, actuator=cell.actuator, seed=seed, part_of=part_of), digest, step)


def previews(
    entries: Sequence[CampaignEntry], check: Callable[[], None] = lambda: None
) -> Mapping[tuple[str, str], Preview]:
    """What each step takes under each condition: everything that `leactl run` would refuse is refused here.

    Parameters
    ----------
    check : called before each; what it raises ends them.

    Raises
    ------
    InputError : a run that its bench does not allow, windings that would grow too hot from ambient, with its place in
        the campaign; too small a disk.
    SafetyTrip : a bench is latched.
    DeviceError : what a device needs is not on this machine.
    """
    by_step: dict[tuple[str, str], Preview] = {}
    faults: dict[str, None] = {}
    first: dict[tuple[str, str], CampaignEntry] = {}
    for entry in entries:
        first.setdefault((entry.cell.step, entry.cell.condition), entry)
    for place, entry in first.items():
        check()
        try:
            by_step[place] = preview(entry.request)
        except InputError as error:
            faults |= dict.fromkeys(entry.step.fault(entry.cell.condition, fault) for fault in error.faults)
    if faults:
        raise InputError(list(faults))
    _check_disk(entries, by_step)
    return by_step


def _check_disk(entries: Sequence[CampaignEntry], by_step: Mapping[tuple[str, str], Preview]) -> None:
    """Room for every run, once, and for the second copy of the largest while it is closed."""
    if not entries:
        return
    needs = [by_step[entry.cell.step, entry.cell.condition].planned_bytes / COPIES for entry in entries]
    benches: list[BenchFile] = [entry.request.bench for entry in entries]
    strictest = max((bench.interlocks.disk_space for bench in benches), key=lambda space: space.trip_MB)
    planned = sum(needs) + (COPIES - 1) * max(needs)
    check_room(strictest, free_bytes(entries[0].request.directory), planned, "the campaign")
