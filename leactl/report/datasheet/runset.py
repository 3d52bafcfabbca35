"""Sets of runs with the results of their analyses; a file that cannot be analysed is an entry with its fault."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

from leactl import yamlfile
from leactl.analysis.analyze import analysis_of, analyze_runs, experiment_of, names
from leactl.analysis.analyze import options_of as options_of_analysis
from leactl.analysis.anova.comparison import Comparison, compare_all
from leactl.analysis.estimate import Result, listed
from leactl.errors import InputError
from leactl.runfile.catalog.summaries import run_files
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import altered

DESCRIBING_ATTRIBUTES = ("run_id", "actuator", "condition", "bench", "operator", "created", "status", "software")
MOST_FOLDERS_IN_NAME = 3  # of a set of runs
StepReporter = Callable[[str], None]


@dataclass
class RunEntry:
    """One run file; `fault` says why it was not analysed, and is empty if it was."""

    path: Path
    label: str = ""  # short name in the datasheet
    model: str = ""  # text of the model file in the run
    motor: str = ""  # name of the motor in the model
    experiment: str = ""
    about: dict[str, str] = field(default_factory=dict)  # values of DESCRIBING_ATTRIBUTES, and mechanical set-up
    instruments: dict[str, dict[str, str]] = field(default_factory=dict)  # properties of each device
    simulated: bool = False
    fault: str = ""

    @property
    def identity(self) -> str:
        """Return the run's identifier, which copies share; the path where the file has none."""
        return self.about.get("run_id", "") or str(self.path.resolve())

    @property
    def group(self) -> tuple[str, str]:
        """Return actuator and condition: runs that share both are analysed together."""
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
    """Comparisons of the results of an experiment between conditions; `refused` says why some were not compared."""

    comparisons: tuple[Comparison, ...]
    refused: tuple[str, ...]


@dataclass(frozen=True)
class RunSet:
    """Runs that are reported together, and their results."""

    name: str
    entries: tuple[RunEntry, ...]
    results: tuple[GroupResult, ...]
    verdicts: Mapping[tuple[str, str], ConditionVerdict]  # by motor and experiment

    @property
    def motors(self) -> list[str]:
        """Return the names of the motors of its runs; that of a run without a motor name is empty."""
        return list(dict.fromkeys(entry.motor for entry in self.entries if entry.experiment))

    def results_of(self, motor: str, experiment: str) -> list[GroupResult]:
        """Return the results of one experiment with one motor, one for each actuator and condition."""
        return [group for group in self.results if (group.motor, group.experiment) == (motor, experiment)]


def read_runs(paths: Sequence[Path], prefix: str, options: Mapping[str, float], report_step: StepReporter) -> RunSet:
    """Read runs and folders of runs and analyse them, repeats combined, by actuator and condition.

    Parameters
    ----------
    prefix : first letter of the runs' labels.
    options : options of analyses by name; each analysis gets those that it takes.
    report_step : is called with the name of each step that begins.

    Raises
    ------
    InputError : no path, a path that does not exist, or a folder without runs.
    """
    report_step("reading")
    entries = [entry_of(path) for path in run_files(paths)]
    entries.sort(key=order_key)
    copy_counts = Counter(entry.identity for entry in entries)
    entry_of_identity: dict[str, RunEntry] = {}
    for entry_number, entry in enumerate(entries, start=1):
        entry.label = f"{prefix}{entry_number}"
        if copy_counts[entry.identity] > 1 and not entry.fault:
            entry.fault = checksum_fault(entry.path)
        first_entry = entry if entry.fault else entry_of_identity.setdefault(entry.identity, entry)
        if first_entry is not entry:
            entry.fault = f"the same run as {first_entry.label}"
    results: list[GroupResult] = []
    verdicts: dict[tuple[str, str], ConditionVerdict] = {}
    usable_entries = sorted(
        (entry for entry in entries if not entry.fault),
        key=lambda entry: (entry.motor, entry.experiment),
    )
    for (motor, experiment), group_entries in groupby(
        usable_entries, key=lambda entry: (entry.motor, entry.experiment)
    ):
        report_step(experiment)
        entries_of_experiment = list(group_entries)
        group_results = [
            group
            for group_members in by_group(entries_of_experiment)
            if (group := group_result_of(group_members, options)) is not None
        ]
        results += group_results
        if len({group.condition for group in group_results}) > 1:
            verdicts[motor, experiment] = condition_verdict(
                [entry for group in group_results for entry in group.entries], options
            )
    return RunSet(name_of_runs(paths), tuple(entries), tuple(results), verdicts)


def order_key(entry: RunEntry) -> tuple[bool, str, bool, str]:
    """Return the key that sorts runs by time.

    Files without an identifier come last. Of copies of one run, one that was cut off while recording comes last.
    """
    run_id = entry.about.get("run_id", "")
    return not run_id, run_id, entry.about.get("status") == "recording", str(entry.path)


def name_of_runs(paths: Sequence[Path]) -> str:
    """Return the name of a set of runs: the names of up to MOST_FOLDERS_IN_NAME folders of its runs."""
    folders = dict.fromkeys(path.resolve() if path.is_dir() else path.resolve().parent for path in paths)
    return listed((folder.name for folder in folders), MOST_FOLDERS_IN_NAME)


def entry_of(path: Path) -> RunEntry:
    """Return the entry of a file with its attributes; it has a fault if the file cannot be read or analysed."""
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
    """Return a text on the values of a run that do not match their checksums; empty if all match."""
    try:
        return fault_text(InputError(altered(path)), path)
    except InputError as fault:
        return fault_text(fault, path)


def motor_of(model: str) -> str:
    """Return the name of the motor in the text of a model file; empty if the text has none or cannot be parsed."""
    try:
        content = yamlfile.parse(model).data if model else None
    except InputError:
        content = None
    name = content.get("name") if isinstance(content, dict) else None
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


def group_result_of(entries: Sequence[RunEntry], options: Mapping[str, float]) -> GroupResult | None:
    """Analyse the runs of one experiment, actuator and condition together.

    If that fails, each run that cannot be analysed by itself gets its fault, and the others are analysed again. The
    result is None if no run is left.
    """
    first_entry = entries[0]
    accepted_options = options_of(first_entry.experiment, options)
    try:
        result = analyze_runs([entry.path for entry in entries], **accepted_options)
    except InputError as joint_fault:
        for entry in entries:
            entry.fault = fault_of(entry, accepted_options) if len(entries) > 1 else fault_text(joint_fault, entry.path)
        analysable = [entry for entry in entries if not entry.fault]
        if len(analysable) == len(entries):
            for entry in entries:
                entry.fault = fault_text(joint_fault, entry.path)
            analysable = []
        return group_result_of(analysable, options) if analysable else None
    return GroupResult(first_entry.motor, first_entry.experiment, *first_entry.group, result, tuple(entries))


def fault_of(entry: RunEntry, options: Mapping[str, Any]) -> str:
    """Return the fault that prevents an analysis of this run alone; empty if it can be analysed."""
    try:
        analyze_runs([entry.path], **options)
    except InputError as fault:
        return fault_text(fault, entry.path)
    return ""


def fault_text(fault: InputError, path: Path) -> str:
    """Return the lines of a fault as one line, without the path before each."""
    return "; ".join(line.removeprefix(f"{path}: ") for line in fault.faults)


def condition_verdict(entries: Sequence[RunEntry], options: Mapping[str, float]) -> ConditionVerdict:
    """Compare the results of an experiment over its conditions, as `leactl stats` does."""
    accepted_options = options_of(entries[0].experiment, options)
    try:
        _, comparisons, refused = compare_all([entry.path for entry in entries], **accepted_options)
    except InputError as fault:
        return ConditionVerdict((), tuple(fault.faults))
    return ConditionVerdict(tuple(comparisons), tuple(refused))


def options_of(experiment: str, options: Mapping[str, float]) -> dict[str, Any]:
    """Return the options without those that the analysis of an experiment does not take."""
    accepted_names = options_of_analysis(analysis_of(experiment, experiment))
    return {name: value for name, value in options.items() if name in accepted_names}


def check_options(options: Mapping[str, float]) -> None:
    """Raise if no analysis takes one of the options.

    Raises
    ------
    InputError : a line for each option that no analysis takes.
    """
    accepted_names = {name for experiment in names() for name in options_of(experiment, options)}
    if unknown_names := [name for name in options if name not in accepted_names]:
        raise InputError([f"--set {name}: no analysis takes it" for name in unknown_names])
