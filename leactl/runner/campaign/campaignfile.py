"""Find campaign files by name or path, and check them as a whole.

An example of a campaign file:

name: paper
title: The experiments of the paper
bench: emulated                          # a name, or a path from this file
actuators: [LEA-1]                       # labels; without this key, runs have no label
conditions: [unloaded, design, loaded]   # without this key, runs have no condition
order: [actuators, conditions, steps, repeats]  # the default, outermost first
shuffle: [conditions]                    # levels whose order is drawn by the seed, anew within each outer block
seed: 1                                  # of the shuffling, and of what emulated benches draw for each run
steps:
  - name: friction
    protocol: friction                   # a name, or a path from this file; the default is the step's name
    bench: mine.yaml                     # instead of the campaign's; a step may have actuators and conditions too
    repeats: 2
    set: {trials: 3}                     # parameters of the protocol
    prompt: Take the coupling off        # added to what the operator is asked to mount before the step
    insert_cooldown: true                # waits within a run where a winding would grow too hot
variants:
  short:                                 # values that replace those of a step with --variant short
    friction: {repeats: 1, set: {trials: 1}}
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from leactl import yamlfile
from leactl.errors import InputError
from leactl.protocol.schema import Seed
from leactl.runner.campaign.order import DEFAULT_ORDER, Cell, Level, arranged
from leactl.yamlblock import Block
from leactl.yamlfile import Location

MOST_RUNS = 10_000
COMMANDS = ("list", "run", "show", "status")  # of `leactl campaign`; no shipped campaign may have such a name

Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", max_length=60)]
Label = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._+-]*$", max_length=60)]
Labels = Annotated[tuple[Label, ...], Field(min_length=1)]
Repeats = Annotated[int, Field(strict=True, ge=1, le=1000)]
NameOrPath = Annotated[str, Field(min_length=1, max_length=1000)]


class StepEntry(Block):
    """One step: a protocol to run on each actuator under each condition.

    Without actuators or conditions of its own, a step has those of the campaign.
    """

    name: Name
    protocol: NameOrPath | None = None
    bench: NameOrPath | None = None
    actuators: Labels | None = None
    conditions: Labels | None = None
    repeats: Repeats = 1
    set: dict[str, Any] = {}
    prompt: Annotated[str, Field(max_length=200)] = ""
    insert_cooldown: Annotated[bool, Field(strict=True)] = False


class Variation(Block):
    """The values of a step that a variant replaces; of `set`, single parameters are replaced."""

    actuators: Labels | None = None
    conditions: Labels | None = None
    repeats: Repeats | None = None
    set: dict[str, Any] = {}


class CampaignFile(Block):
    """The keys of a campaign file."""

    name: Name
    title: Annotated[str, Field(max_length=200)] = ""
    bench: NameOrPath
    actuators: Labels | None = None
    conditions: Labels | None = None
    order: tuple[Level, ...] = DEFAULT_ORDER
    shuffle: tuple[Level, ...] = ()
    seed: Seed = 1
    steps: Annotated[tuple[StepEntry, ...], Field(min_length=1)]
    variants: dict[Name, dict[str, Variation]] = {}


@dataclass(frozen=True)
class CampaignStep:
    """A step of the campaign after the defaults of the campaign and one variant are applied."""

    name: str
    document: yamlfile.Document  # of the campaign
    location: Location  # of the step in the document
    protocol: str
    bench: str
    actuators: Sequence[str]
    conditions: Mapping[str, Location]  # label: its location in the document
    repeats: int
    settings: Mapping[str, Location]  # `name=value` as after `--set`: its location in the document
    prompt: str
    insert_cooldown: bool

    def fault(self, condition: str, message: str) -> str:
        """Return the message of a run's fault, preceded by its location in the campaign file.

        The location is that of the setting or condition that the message names, or else that of the step.
        """
        fault_location = self.location
        if condition and message.startswith(f"condition '{condition}' "):
            fault_location = self.conditions[condition]
        for setting, setting_location in self.settings.items():
            # `--set` precedes the message on a wrong value, and is within that on a protocol line that takes the value
            shorter = message.removeprefix(f"--set {setting}: ").replace(f" from --set {setting}", "")
            if shorter != message:
                fault_location, message = setting_location, shorter
        return self.document.fault(fault_location, message)


@dataclass(frozen=True)
class Campaign:
    """A checked campaign: its steps, and the cells of its runs in the order of execution."""

    name: str
    title: str
    variant: str  # "" for the campaign as it is written
    seed: int
    steps: Mapping[str, CampaignStep]
    cells: Sequence[Cell]
    text: str


def names() -> list[str]:
    """Return the names of the campaigns that ship with leactl."""
    return sorted(path.stem for path in _shipped().glob("*.yaml"))


def locate(name_or_path: str) -> Path:
    """Return the path of a campaign file, given the name of a shipped campaign or the path itself.

    Raises
    ------
    InputError : no shipped campaign has this name and it is no path to a .yaml.
    """
    if name_or_path in names():
        return _shipped() / f"{name_or_path}.yaml"
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"campaign '{name_or_path}' is not known; known: {', '.join(names())}, or a path to a .yaml")
    return path


def load(name_or_path: str, variant: str = "", seed: int | None = None) -> Campaign:
    """Read and check a campaign, by its shipped name or from a file; its protocols and benches are not read yet.

    Raises
    ------
    InputError : no such campaign, or faults in it, all at once with file, line and column.
    """
    path = locate(name_or_path)
    document = yamlfile.load(path)
    if not isinstance(document.data, dict):
        raise InputError(
            document.fault((), f"a mapping with keys of {', '.join(CampaignFile.model_fields)} was expected")
        )
    try:
        file = CampaignFile.model_validate(document.data)
    except ValidationError as error:
        raise InputError(document.explain(error)) from None
    faults = list(_faults(document, file))
    if variant and variant not in file.variants:
        known = ", ".join(file.variants) or "none"
        faults.append(document.fault(("variants",), f"variant '{variant}' is not known; known: {known}"))
    if faults:
        raise InputError(faults)
    steps = {entry.name: _step(document, file, index, path.parent) for index, entry in enumerate(file.steps)}
    for name, change in file.variants.get(variant, {}).items():
        steps[name] = _with_variation(steps[name], change, ("variants", variant, name))
    count = sum(len(step.actuators) * len(step.conditions) * step.repeats for step in steps.values())
    if count > MOST_RUNS:
        raise InputError(document.fault(("steps",), f"{count} runs; at most {MOST_RUNS} were expected"))
    effective_seed = file.seed if seed is None else seed
    cells = _ordered_cells(file, steps, effective_seed)
    return Campaign(file.name, file.title, variant, effective_seed, steps, cells, document.text)


def _shipped() -> Path:
    """Return the folder of the campaign files that ship with leactl."""
    return Path(str(resources.files("leactl_protocols.campaigns")))


def _faults(document: yamlfile.Document, file: CampaignFile) -> Iterator[str]:
    """Yield the faults of a campaign file that its schema does not find, each with its location."""
    seen: dict[str, int] = {}
    for index, step in enumerate(file.steps):
        first = seen.setdefault(step.name, index)
        if first != index:
            line = document.places["steps", first, "name"][0]
            yield document.fault(("steps", index, "name"), f"'{step.name}' is the name of the step in line {line} too")
        yield from _faults_of_block(document, step, ("steps", index))
    yield from _repeated_items(document, ("actuators",), file.actuators or ())
    yield from _repeated_items(document, ("conditions",), file.conditions or ())
    yield from _repeated_items(document, ("shuffle",), file.shuffle)
    if sorted(file.order) != sorted(DEFAULT_ORDER):
        yield document.fault(("order",), f"each of {', '.join(DEFAULT_ORDER)} was expected once")
    for name, changes in file.variants.items():
        for step_name, change in changes.items():
            location = ("variants", name, step_name)
            if step_name not in seen:
                yield document.fault(location, f"there is no such step; there are: {', '.join(seen)}")
            yield from _faults_of_block(document, change, location)


def _faults_of_block(document: yamlfile.Document, block: StepEntry | Variation, location: Location) -> Iterator[str]:
    """Yield the faults of one step, or of the changes that a variant makes in a step."""
    yield from _repeated_items(document, (*location, "actuators"), block.actuators or ())
    yield from _repeated_items(document, (*location, "conditions"), block.conditions or ())
    if "seed" in block.set:
        yield document.fault((*location, "set", "seed"), "the campaign has its own seed, which each run draws its from")
    for name, value in block.set.items():
        if isinstance(value, dict) or value is None:
            yield document.fault((*location, "set", name), "a number, a text or a list of these was expected")


def _repeated_items(document: yamlfile.Document, location: Location, items: Sequence[str]) -> Iterator[str]:
    """Yield one fault for each item of a list that is in it already."""
    for index, item in enumerate(items):
        if item in items[:index]:
            yield document.fault((*location, index), f"'{item}' stands twice")


def _step(document: yamlfile.Document, file: CampaignFile, index: int, folder: Path) -> CampaignStep:
    """Return a step of a campaign file, with the defaults of the campaign; `folder` is that of the file."""
    entry, location = file.steps[index], ("steps", index)
    return CampaignStep(
        name=entry.name,
        document=document,
        location=location,
        protocol=_resolved(folder, entry.protocol or entry.name),
        bench=_resolved(folder, entry.bench or file.bench),
        actuators=entry.actuators or file.actuators or ("",),
        conditions=_conditions(entry.conditions, location) or _conditions(file.conditions, ()) or {"": location},
        repeats=entry.repeats,
        settings=_settings(entry.set, location),
        prompt=entry.prompt,
        insert_cooldown=entry.insert_cooldown,
    )


def _with_variation(step: CampaignStep, change: Variation, location: Location) -> CampaignStep:
    """Return a step with the changes that a variant makes in it."""
    unchanged = {
        setting: location for setting, location in step.settings.items() if setting.partition("=")[0] not in change.set
    }
    return replace(
        step,
        actuators=change.actuators or step.actuators,
        conditions=_conditions(change.conditions, location) or step.conditions,
        repeats=change.repeats or step.repeats,
        settings=unchanged | _settings(change.set, location),
    )


def _conditions(labels: Labels | None, location: Location) -> dict[str, Location]:
    """Return the location of each condition, by its label."""
    return {label: (*location, "conditions", index) for index, label in enumerate(labels or ())}


def _settings(values: Mapping[str, Any], location: Location) -> dict[str, Location]:
    """Return the location of each parameter, by its text `name=value`."""
    return {f"{name}={_setting_text(value)}": (*location, "set", name) for name, value in values.items()}


def _setting_text(value: Any) -> str:
    """Return a value as the text after `--set name=`; a text in a list is quoted, because it may contain a comma."""
    if isinstance(value, list):
        quoted = [
            "'{}'".format(item.replace("'", "''")) if isinstance(item, str) else _setting_text(item) for item in value
        ]
        return f"[{', '.join(quoted)}]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _resolved(folder: Path, name: str) -> str:
    """Return a path resolved from the campaign's folder, and the name of a shipped file unchanged."""
    return str(folder / name) if name.endswith((".yaml", ".yml")) else name


def _ordered_cells(file: CampaignFile, steps: Mapping[str, CampaignStep], seed: int) -> list[Cell]:
    """Return the cells of all steps in the order of execution."""
    cells = [
        Cell(step.name, actuator, condition, repeat)
        for step in steps.values()
        for actuator in step.actuators
        for condition in step.conditions
        for repeat in range(1, step.repeats + 1)
    ]
    level_values: dict[Level, list[str | int]] = {
        "actuators": list(dict.fromkeys([*(file.actuators or ()), *(cell.actuator for cell in cells)])),
        "conditions": list(dict.fromkeys([*(file.conditions or ()), *(cell.condition for cell in cells)])),
        "steps": list(steps),
        "repeats": list(range(1, max(step.repeats for step in steps.values()) + 1)),
    }
    return arranged(cells, file.order, level_values, file.shuffle, seed)
