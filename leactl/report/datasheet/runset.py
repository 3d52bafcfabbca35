"""A set of runs and the results of their analyses; each file is an entry, also one that cannot be analysed."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

from leactl import yamlfile
from leactl.analysis.analyze import analysis_of, analyze_runs, experiment_of, names
from leactl.analysis.analyze import options_of as taken_by
from leactl.analysis.anova.comparison import Comparison, compare_all
from leactl.analysis.estimate import Result, listed
from leactl.errors import InputError
from leactl.runfile.catalog.summaries import run_files
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import altered

DESCRIBING_ATTRIBUTES = ("run_id", "actuator", "condition", "bench", "operator", "created", "status", "software")
MOST_NAMED = 3  # folders in the name of a set of runs
Tell = Callable[[str], None]


@dataclass
class RunEntry:
    """One file; `fault` says why it was not analysed and is empty where it was."""

    path: Path
    label: str = ""  # short name in the datasheet
    model: str = ""  # the text that the run carries
    motor: str = ""  # its name in that model
    experiment: str = ""
    about: dict[str, str] = field(default_factory=dict)
    instruments: dict[str, dict[str, str]] = field(default_factory=dict)  # properties of each device
    simulated: bool = False
    fault: str = ""

    @property
    def identity(self) -> str:
        """Return the run's identifier, which copies share; the path where the file has none."""
        return self.about.get("run_id", "") or str(self.path.resolve())

    @property
    def group(self) -> tuple[str, str]:
        """Return actuator and condition."""
        return self.about.get("actuator", ""), self.about.get("condition", "")


@dataclass(frozen=True)
class GroupResult:
    """The result of the runs of one experiment, actuator and condition."""

    motor: str
    experiment: str
    actuator: str
    condition: str
    result: Result
    entries: tuple[RunEntry, ...]


@dataclass(frozen=True)
class ConditionVerdict:
    """Whether the results of an experiment differ between conditions; `refused` says why some were not compared."""

    comparisons: tuple[Comparison, ...]
    refused: tuple[str, ...]


@dataclass(frozen=True)
class RunSet:
    """Runs that are reported together, and their results."""

    name: str
    entries: tuple[RunEntry, ...]
    answers: tuple[GroupResult, ...]
    verdicts: Mapping[tuple[str, str], ConditionVerdict]  # by motor and experiment

    @property
    def motors(self) -> list[str]:
        """Return the motors of its runs in order; a run that names none has an empty name."""
        return list(dict.fromkeys(entry.motor for entry in self.entries if entry.experiment))

    def answers_of(self, motor: str, experiment: str) -> list[GroupResult]:
        """Return the results of one experiment with one motor, one for each actuator and condition."""
        return [answer for answer in self.answers if (answer.motor, answer.experiment) == (motor, experiment)]


def read_runs(paths: Sequence[Path], prefix: str, options: Mapping[str, float], tell: Tell) -> RunSet:
    """Read runs and folders of runs and analyse them, repeats combined, by actuator and condition.

    Parameters
    ----------
    prefix : first letter of the runs' labels.
    options : options of analyses by name; each analysis gets those that it takes.
    tell : is called with the name of each step that begins.

    Raises
    ------
    InputError : no path, a path that does not exist, or a folder without runs.
    """
    tell("reading")
    entries = [entry_of(path) for path in run_files(paths)]
    entries.sort(key=order_key)
    copies = Counter(entry.identity for entry in entries)
    entry_of_identity: dict[str, RunEntry] = {}
    for number, entry in enumerate(entries, start=1):
        entry.label = f"{prefix}{number}"
        if copies[entry.identity] > 1 and not entry.fault:
            entry.fault = checksum_fault(entry.path)
        first = entry if entry.fault else entry_of_identity.setdefault(entry.identity, entry)
        if first is not entry:
            entry.fault = f"the same run as {first.label}"
    answers: list[GroupResult] = []
    verdicts: dict[tuple[str, str], ConditionVerdict] = {}
    usable = sorted(
        (entry for entry in entries if not entry.fault),
        key=lambda entry: (entry.motor, entry.experiment),
    )
    for (motor, experiment), alike in groupby(usable, key=lambda entry: (entry.motor, entry.experiment)):
        tell(experiment)
        members = list(alike)
        group_results = [answer for group in by_group(members) if (answer := answer_of(group, options)) is not None]
        answers += group_results
        if len({answer.condition for answer in group_results}) > 1:
            verdicts[motor, experiment] = condition_verdict(
                [entry for answer in group_results for entry in answer.entries], options
            )
    return RunSet(name_of_runs(paths), tuple(entries), tuple(answers), verdicts)


def order_key(entry: RunEntry) -> tuple[bool, str, bool, str]:
    """Return the key that sorts runs by time; files without an identifier come last, unfinished copies after others."""
    run_id = entry.about.get("run_id", "")
    return not run_id, run_id, entry.about.get("status") == "recording", str(entry.path)


def name_of_runs(paths: Sequence[Path]) -> str:
    """Return the names of the folders that the runs lie in."""
    folders = dict.fromkeys(path.resolve() if path.is_dir() else path.resolve().parent for path in paths)
    return listed((folder.name for folder in folders), MOST_NAMED)


def entry_of(path: Path) -> RunEntry:
    """Read the attributes of a file; `fault` says why it cannot be analysed."""
    try:
        with Run.open(path) as run:
            model = run.source("model") or ""
            entry = RunEntry(path, "", model, motor_of(model), experiment_of(run), simulated=is_simulated(run))
            entry.about = {name: str(run.attributes.get(name, "")) for name in DESCRIBING_ATTRIBUTES}
            entry.about["mechanical"] = run.mechanical
            entry.instruments = run.instruments
    except InputError as fault:
        return RunEntry(path, fault=fault_text(fault, path))
    if entry.experiment not in names():
        reason = f"no analysis '{entry.experiment}' is known" if entry.experiment else "the run names no analysis"
        entry.fault = f"{reason}; known: {', '.join(names())}"
    return entry


def checksum_fault(path: Path) -> str:
    """Return which values of a run do not match their checksums; empty where all do."""
    try:
        return fault_text(InputError(altered(path)), path)
    except InputError as fault:
        return fault_text(fault, path)


def motor_of(model: str) -> str:
    """Return the motor's name in the model text that a run carries; empty where there is none that can be read."""
    try:
        data = yamlfile.parse(model).data if model else None
    except InputError:
        data = None
    name = data.get("name") if isinstance(data, dict) else None
    return name if isinstance(name, str) else ""


def is_simulated(run: Run) -> bool:
    """Return whether the run is from an emulated bench."""
    return str(run.attributes.get("simulated", "")) == "1"


def by_group(entries: Sequence[RunEntry]) -> list[list[RunEntry]]:
    """Group entries by actuator and condition, in the order of each group's first entry."""
    groups: dict[tuple[str, str], list[RunEntry]] = {}
    for entry in entries:
        groups.setdefault(entry.group, []).append(entry)
    return list(groups.values())


def answer_of(entries: Sequence[RunEntry], options: Mapping[str, float]) -> GroupResult | None:
    """Analyse the runs of one experiment, actuator and condition; a run that prevents it is left out with its fault."""
    first = entries[0]
    accepted = options_of(first.experiment, options)
    try:
        result = analyze_runs([entry.path for entry in entries], **accepted)
    except InputError as joint_fault:
        for entry in entries:
            entry.fault = fault_of(entry, accepted) if len(entries) > 1 else fault_text(joint_fault, entry.path)
        sound = [entry for entry in entries if not entry.fault]
        if len(sound) == len(entries):
            for entry in entries:
                entry.fault = fault_text(joint_fault, entry.path)
            sound = []
        return answer_of(sound, options) if sound else None
    return GroupResult(first.motor, first.experiment, *first.group, result, tuple(entries))


def fault_of(entry: RunEntry, options: Mapping[str, Any]) -> str:
    """Return why a run cannot be analysed by itself; empty where it can."""
    try:
        analyze_runs([entry.path], **options)
    except InputError as fault:
        return fault_text(fault, entry.path)
    return ""


def fault_text(fault: InputError, path: Path) -> str:
    """Return the lines of a fault without the path in front of each."""
    return "; ".join(line.removeprefix(f"{path}: ") for line in fault.faults)


def condition_verdict(entries: Sequence[RunEntry], options: Mapping[str, float]) -> ConditionVerdict:
    """Compare the results of an experiment over its conditions, as `leactl stats` does."""
    accepted = options_of(entries[0].experiment, options)
    try:
        _, comparisons, refused = compare_all([entry.path for entry in entries], **accepted)
    except InputError as fault:
        return ConditionVerdict((), tuple(fault.faults))
    return ConditionVerdict(tuple(comparisons), tuple(refused))


def options_of(experiment: str, options: Mapping[str, float]) -> dict[str, Any]:
    """Return the options that the analysis of an experiment takes."""
    accepted = taken_by(analysis_of(experiment, experiment))
    return {name: value for name, value in options.items() if name in accepted}


def refuse_untaken(options: Mapping[str, float]) -> None:
    """Refuse options that no analysis takes.

    Raises
    ------
    InputError : a line for each such option.
    """
    accepted = {name for experiment in names() for name in options_of(experiment, options)}
    if unknown := [name for name in options if name not in accepted]:
        raise InputError([f"--set {name}: no analysis takes it" for name in unknown])
