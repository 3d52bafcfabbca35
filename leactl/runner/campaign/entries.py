"""Make requests for the runs of a campaign, and report all faults of all runs before the first run begins."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from hashlib import sha256
from pathlib import Path

from leactl.bench.benchfile import BenchFile
from leactl.errors import InputError
from leactl.model.motor import load_motor
from leactl.protocol.plan import Prompt, Samples
from leactl.runner.campaign.campaignfile import Campaign, CampaignStep
from leactl.runner.campaign.order import Cell, hashed_number
from leactl.runner.dry_run import Preview, preview
from leactl.runner.request import Request, prepare
from leactl.safety.disk import COPIES, check_room, free_bytes

DIGEST_DIGITS = 16  # hexadecimal


@dataclass(frozen=True)
class CampaignEntry:
    """One run that a campaign asks for."""

    cell: Cell
    request: Request
    digest: str  # of everything that determines the run: key, protocol, parameters, signals, bench, motors, ...
    step: CampaignStep

    @property
    def mounting(self) -> tuple[str, ...]:
        """Bench, set-up, actuator, condition and prompt; a person has to act only if they change from run to run."""
        request = self.request
        return request.bench.name, request.plan.setup, self.cell.actuator, self.cell.condition, self.step.prompt

    @property
    def mounting_prompt(self) -> str:
        """Text that tells the operator what to mount for this run."""
        actuator = f"actuator '{self.cell.actuator}', " if self.cell.actuator else ""
        condition = f"condition '{self.cell.condition}', " if self.cell.condition else ""
        step_prompt = f": {self.step.prompt}" if self.step.prompt else ""
        bench = self.request.bench.name
        return (
            f"bench '{bench}': {actuator}{condition}set-up {self.request.plan.setup}, for {self.cell.step}{step_prompt}"
        )

    @property
    def protocol_has_prompts(self) -> bool:
        """Whether the protocol itself asks the operator for something during the run."""
        return any(isinstance(action, Prompt) for action in self.request.plan.actions)


@dataclass(frozen=True)
class EntryOptions:
    """Options of `leactl run` that are the same for every run of a campaign."""

    folder: Path
    operator: str = ""
    realtime: bool = False
    served: bool = False
    buses: Sequence[str] = ()


def entries_of(campaign: Campaign, options: EntryOptions) -> list[CampaignEntry]:
    """Return every run of a campaign in its order, checked as `leactl run` checks it.

    Raises
    ------
    InputError : faults of protocols, benches and settings, each with its location in the campaign.
    """
    faults: list[str] = []
    prepared: dict[tuple[str, str], Request] = {}
    for step in campaign.steps.values():
        for condition in step.conditions:
            try:
                prepared[step.name, condition] = _prepared(step, condition, options)
            except InputError as error:
                faults += [step.fault(condition, fault) for fault in error.faults]
    if faults:
        raise InputError(list(dict.fromkeys(faults)))
    return [
        _entry(cell, campaign, prepared[cell.step, cell.condition], campaign.steps[cell.step])
        for cell in campaign.cells
    ]


def _prepared(step: CampaignStep, condition: str, options: EntryOptions) -> Request:
    """Return the request for a step under one condition, for any actuator and repeat."""
    request = prepare(
        step.protocol,
        step.bench,
        list(step.settings),
        "",
        condition,
        options.operator,
        options.folder,
        options.realtime,
        options.served,
        options.buses,
    )
    return replace(request, insert_cooldown=step.insert_cooldown)


def _entry(cell: Cell, campaign: Campaign, prepared: Request, step: CampaignStep) -> CampaignEntry:
    """Return the entry of a cell: the prepared request with actuator, seed and campaign, and its digest."""
    # with one seed, repeats on an emulated bench would be the same to the last digit
    seed = hashed_number(f"{campaign.seed}/{cell.key}") if prepared.in_process else None
    digest_inputs = {
        "key": cell.key,
        "protocol": prepared.plan.text,
        "parameters": dict(prepared.plan.parameters),
        "bench": prepared.bench_document.text,
        "motors": {role: load_motor(name)[1].text for role, name in prepared.bench.motors.items()},
        "signals": [sha256(samples.values.tobytes()).hexdigest() for samples in _samples_in(prepared.plan.actions)],
        "insert_cooldown": step.insert_cooldown,
        "seed": seed,
    }
    digest = sha256(json.dumps(digest_inputs, sort_keys=True).encode()).hexdigest()[:DIGEST_DIGITS]
    part_of = {
        "name": campaign.name,
        "variant": campaign.variant,
        "run": cell.key,
        "step": cell.step,
        "repeat": str(cell.repeat),
        "digest": digest,
    }
    return CampaignEntry(cell, replace(prepared, actuator=cell.actuator, seed=seed, part_of=part_of), digest, step)


def _samples_in(part: object) -> Iterator[Samples]:
    """Yield the sampled signals in a part of a plan: a file that they come from may change between two runs."""
    if isinstance(part, Samples):
        yield part
    elif isinstance(part, tuple | list):
        for item in part:
            yield from _samples_in(item)
    elif isinstance(part, Mapping):
        yield from _samples_in(list(part.values()))
    elif is_dataclass(part):
        yield from _samples_in([getattr(part, field.name) for field in fields(part)])


def previews(
    entries: Sequence[CampaignEntry], check: Callable[[], None] = lambda: None
) -> Mapping[tuple[str, str], Preview]:
    """Return a preview for each pair of step and condition, and refuse everything that `leactl run` would refuse.

    Parameters
    ----------
    check : called before each preview; an exception from it is passed on.

    Raises
    ------
    InputError : a run that its bench does not allow, windings that would grow too hot from ambient, with its location
        in the campaign; too small a disk.
    SafetyTrip : a bench is latched.
    DeviceError : what a device needs is not on this machine.
    """
    preview_of: dict[tuple[str, str], Preview] = {}
    faults: dict[str, None] = {}
    first_entries: dict[tuple[str, str], CampaignEntry] = {}
    for entry in entries:
        first_entries.setdefault((entry.cell.step, entry.cell.condition), entry)
    for step_and_condition, entry in first_entries.items():
        check()
        try:
            preview_of[step_and_condition] = preview(entry.request)
        except InputError as error:
            faults |= dict.fromkeys(entry.step.fault(entry.cell.condition, fault) for fault in error.faults)
    if faults:
        raise InputError(list(faults))
    _check_disk(entries, preview_of)
    return preview_of


def _check_disk(entries: Sequence[CampaignEntry], preview_of: Mapping[tuple[str, str], Preview]) -> None:
    """Raise InputError unless the disk has room for every run, and for a second copy of the largest run at its end."""
    if not entries:
        return
    run_bytes = [preview_of[entry.cell.step, entry.cell.condition].planned_bytes / COPIES for entry in entries]
    benches: list[BenchFile] = [entry.request.bench for entry in entries]
    strictest = max((bench.interlocks.disk_space for bench in benches), key=lambda space: space.trip_MB)
    planned = sum(run_bytes) + (COPIES - 1) * max(run_bytes)
    check_room(strictest, free_bytes(entries[0].request.directory), planned, "the campaign")
