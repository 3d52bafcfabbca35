"""Find the analysis of each run's experiment and apply it to the runs of each actuator and condition."""

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from leactl.analysis.estimate import Covariance, Estimate, Grid, Plot, Result
from leactl.analysis.quality.channel_plausibility import channel_doubts
from leactl.analysis.registry import GENERIC_ANALYSIS, Experiment, load, names
from leactl.errors import InputError
from leactl.processes import HERE, Workers
from leactl.runfile.catalog.summaries import analysis_in
from leactl.runfile.read.reader import Run
from leactl.runfile.verify import integrity

__all__ = ["GENERIC_ANALYSIS", "Experiment", "analyze_runs", "names"]


def is_known(experiment: str) -> bool:
    """Return whether an experiment of this name can be analysed."""
    return experiment.replace("_", "-") in names()


def analysis_of(experiment: str, error_prefix: str) -> Experiment:
    """Return the experiment of this name.

    Raises
    ------
    InputError : no experiment has this name, or it cannot be used; `error_prefix` opens the message.
    """
    try:
        return load(experiment)
    except InputError as fault:
        raise InputError(f"{error_prefix}: {fault}") from None


def method_of(experiment: str) -> str:
    """Return the sentence that says how an experiment is analysed.

    Raises
    ------
    InputError : there is no such experiment, or it cannot be used.
    """
    return load(experiment).method


def results_of(experiment: str) -> dict[str, str]:
    """Return the unit of every result that an experiment may give, by the result's name.

    Raises
    ------
    InputError : there is no such experiment, or it cannot be used.
    """
    return dict(load(experiment).results)


def experiment_of(run: Run) -> str:
    """Return a run's experiment: `analysis` in its protocol, else the protocol's name if it is one, else `channels`."""
    stated = analysis_in(run.source("protocol") or "")
    protocol = str(run.attributes.get("protocol", ""))
    return stated or (protocol if is_known(protocol) else GENERIC_ANALYSIS)


@dataclass(frozen=True)
class InspectedRun:
    """Properties and faults of one run, found before it is analysed together with others."""

    path: Path
    identity: str  # the same for two files of one run
    group: tuple[str, str]  # actuator and condition
    experiment: str
    altered: list[str]  # a line for each part of the file whose checksum no longer matches
    unreadable: list[str]  # faults that prevent a check of its channels
    doubts: list[str]  # notes on doubtful channels
    condemned: dict[str, str]  # by `stream/name` of a channel: why it cannot be analysed (`Run.condemned`)
    remarks: list[str]  # notes on a run that ended early


Groups = Sequence[Sequence[InspectedRun]]  # each group: the runs of one actuator under one condition
GroupAnalysis = Callable[[Experiment, Groups, dict[str, Any]], Iterator[Result]]  # yields the result of each group


def inspect_run(run: Run, experiment: str) -> InspectedRun:
    """Check one run's integrity and channels, and find its experiment and its group.

    Parameters
    ----------
    experiment : name of the experiment; if empty, `experiment_of` finds it.
    """
    doubts: list[str] = []
    unreadable: list[str] = []
    altered = integrity.altered(run.path)
    if not altered:
        try:
            doubts = channel_doubts(run)
        except InputError as fault:  # raised later, since it stops the analysis of all runs together
            unreadable = fault.faults
    group = str(run.attributes.get("actuator", "")), str(run.attributes.get("condition", ""))
    return InspectedRun(
        run.path,
        identity_of(run),
        group,
        experiment or experiment_of(run),
        altered,
        unreadable,
        doubts,
        run.condemned,
        remarks_on(run),
    )


def analyze_runs(paths: Sequence[Path | str], experiment: str = "", **options: Any) -> Result:
    """Analyse runs of one experiment: one set of results for each actuator and condition, repeats combined.

    Parameters
    ----------
    experiment : name of the experiment; if empty, `experiment_of` finds that of each run.
    options : of the analysis; an option that is None counts as not given.

    Raises
    ------
    InputError : a file is no run, its values changed after its close, a run is given twice, the runs are of different
        experiments, or the analysis cannot estimate its results from them.
    """
    with ExitStack() as open_files:
        runs = {run.path: run for run in [open_files.enter_context(Run.open(path)) for path in paths]}

        def analyze_groups(analysis: Experiment, groups: Groups, given_options: dict[str, Any]) -> Iterator[Result]:
            for members in groups:
                yield analysis.answer([runs[member.path] for member in members], **given_options)

        return analyze_inspected([inspect_run(runs[Path(path)], experiment) for path in paths], analyze_groups, options)


def analyze_inspected(
    inspected: Sequence[InspectedRun], analyze_groups: GroupAnalysis, options: Mapping[str, Any]
) -> Result:
    """Analyse runs that `inspect_run` has checked.

    Parameters
    ----------
    analyze_groups : yields the result of each group of runs, in order.

    Raises
    ------
    InputError : no run is given, or a cause that `analyze_runs` lists.
    """
    if not inspected:
        raise InputError("no run to analyse; give one run file or more")
    refuse_duplicates((run.identity, run.path) for run in inspected)
    integrity.refuse_findings([finding for run in inspected for finding in run.altered])
    if unreadable := next((run.unreadable for run in inspected if run.unreadable), []):
        raise InputError(unreadable)
    first_run = inspected[0]
    for run in inspected:
        if run.experiment != first_run.experiment:
            raise InputError(
                f"{run.path}: its analysis is '{run.experiment}', that of {first_run.path} is"
                f" '{first_run.experiment}'; give runs of one experiment"
            )
    analysis = analysis_of(first_run.experiment, str(first_run.path))
    given_options = {name: value for name, value in options.items() if value is not None}
    refuse_unknown(analysis, given_options)
    groups: dict[tuple[str, str], list[InspectedRun]] = {}
    for run in inspected:
        groups.setdefault(run.group, []).append(run)
    doubts = [note for run in inspected for note in run.doubts]
    with doubts_before_refusal(doubts):
        results = dict(zip(groups, analyze_groups(analysis, list(groups.values()), given_options), strict=True))
    return combine_results(first_run.experiment, inspected, results, doubts)


def analyze_each(
    paths: Sequence[Path], experiment: str = "", workers: Workers = HERE, **options: Any
) -> tuple[list[Result], list[str]]:
    """Analyse runs experiment by experiment, in the order in which each first appears.

    Parameters
    ----------
    experiment, options : as of `analyze_runs`; of several experiments each gets the options that it takes.
    workers : processes that inspect the runs and analyse the groups; the results do not depend on their number.

    Returns
    -------
    A result for each experiment that could be analysed, and a line for each fault of the others.

    Raises
    ------
    InputError : all runs are of one experiment, which cannot be analysed, or no experiment takes one of the options.
    """
    experiments: dict[str, list[InspectedRun]] = {}
    faults: list[str] = []
    for outcome in workers.in_order(_inspect_file, [(path, experiment) for path in paths]):
        faults += outcome.faults
        if not outcome.faults:
            experiments.setdefault(outcome.value().experiment, []).append(outcome.value())

    def analyze_groups(analysis: Experiment, groups: Groups, given_options: dict[str, Any]) -> Iterator[Result]:
        jobs = [
            (analysis.name, [(member.path, member.condemned) for member in members], given_options)
            for members in groups
        ]
        yield from (outcome.value() for outcome in workers.in_order(_analyze_group, jobs))

    if faults and not experiments:  # no experiment is left that could take an option
        return [], faults
    if len(experiments) == 1 and not faults:
        return [analyze_inspected(members, analyze_groups, options) for members in experiments.values()], []
    given_options = {name: value for name, value in options.items() if value is not None}
    results: list[Result] = []
    used_options: set[str] = set()
    for name, members in experiments.items():
        try:
            accepted = options_of(analysis_of(name, str(members[0].path)))
            accepted_options = {key: given_options[key] for key in accepted if key in given_options}
            used_options |= accepted_options.keys()
            results.append(analyze_inspected(members, analyze_groups, accepted_options))
        except InputError as fault:
            faults += fault.faults
    if unused := [key for key in given_options if key not in used_options]:
        raise InputError([f"--set {key}: none of {', '.join(experiments)} takes it" for key in unused])
    return results, faults


def _inspect_file(path: Path, experiment: str) -> InspectedRun:
    """Open a run file and return what `inspect_run` finds."""
    with Run.open(path) as run:
        return inspect_run(run, experiment)


def _analyze_group(
    experiment: str, members: Sequence[tuple[Path, dict[str, str]]], given_options: dict[str, Any]
) -> Result:
    """Return the result of one group; `members` are the path of each run and its condemned channels."""
    with ExitStack() as open_files:
        runs = [open_files.enter_context(Run.open(path)) for path, _ in members]
        for run, (_, condemned) in zip(runs, members, strict=True):
            run.condemned = condemned
        return load(experiment).answer(runs, **given_options)


def by_experiment(paths: Sequence[Path], experiment: str = "") -> tuple[dict[str, list[Path]], list[str]]:
    """Group runs by experiment; return the groups, and a line for each file that is no run.

    `experiment`, if given, counts as the experiment of every run.
    """
    groups: dict[str, list[Path]] = {}
    faults: list[str] = []
    for path in paths:
        try:
            with Run.open(path) as run:
                groups.setdefault(experiment or experiment_of(run), []).append(path)
        except InputError as fault:
            faults += fault.faults
    return groups, faults


@contextmanager
def doubts_before_refusal(doubts: Sequence[str]) -> Iterator[None]:
    """Put the doubts about channels before the message of an analysis that fails: they are its likely cause."""
    try:
        yield
    except InputError as fault:
        if not doubts or fault.faults[0] in doubts:
            raise
        raise type(fault)(["; ".join([*doubts, fault.faults[0]]), *fault.faults[1:]]) from fault


def numeric_options(settings: Sequence[str], **named_options: float | None) -> dict[str, float]:
    """Return the numeric options of an analysis by name.

    Parameters
    ----------
    settings : texts `name=number`, as `--set` takes them.
    named_options : options that have a separate command-line option; None for one that is not given.

    Raises
    ------
    InputError : a line for each setting that is no `name=number` or whose name is given twice.
    """
    faults, values = [], {name: value for name, value in named_options.items() if value is not None}
    for setting in settings:
        name, _, number_text = (part.strip() for part in setting.partition("="))
        try:
            value = float(number_text)
        except ValueError:
            value = math.nan
        if not (name.isidentifier() and math.isfinite(value)):
            faults.append(f"--set {setting}: name=number was expected")
        elif name in values:
            faults.append(f"--set {name}: given twice")
        else:
            values[name] = value
    if faults:
        raise InputError(faults)
    return values


def combine_results(
    experiment: str,
    inspected: Sequence[InspectedRun],
    group_results: dict[tuple[str, str], Result],
    doubts: Sequence[str] = (),
) -> Result:
    """Combine the results of all groups into one result.

    Its notes begin with the doubts about channels. A note that not all groups share names its actuator and condition.
    """
    estimates: list[Estimate] = []
    plots: list[Plot] = []
    covariances: list[Covariance] = []
    grids: list[Grid] = []
    notes = [*doubts, *(note for run in inspected for note in run.remarks)]
    shared_notes = set.intersection(*(set(result.notes) for result in group_results.values()))
    notes += [note for note in next(iter(group_results.values())).notes if note in shared_notes]
    for (actuator, condition), result in group_results.items():
        prefix = f"{' '.join(filter(None, (actuator, condition))) or 'unnamed'}: " if len(group_results) > 1 else ""
        estimates += [replace(item, actuator=actuator, condition=condition) for item in result.results]
        plots += [replace(item, actuator=actuator, condition=condition) for item in result.plots]
        covariances += [replace(item, actuator=actuator, condition=condition) for item in result.covariances]
        grids += [replace(item, actuator=actuator, condition=condition) for item in result.grids]
        notes += [prefix + note for note in result.notes if note not in shared_notes]
    paths = tuple(str(run.path) for run in inspected)
    return Result(
        experiment, paths, tuple(estimates), tuple(dict.fromkeys(notes)), tuple(plots), tuple(covariances), tuple(grids)
    )


def remarks_on(run: Run) -> list[str]:
    """Return a note on a run that ended early, with its status and the reason; an empty list for a complete run."""
    if run.status in ("complete", ""):
        return []
    reason = str(run.attributes.get("status_reason", ""))
    reason_text = f" ({reason})" if reason else ""
    return [f"{run.path}: status is '{run.status}'{reason_text}; analysed as far as its steps go"]


def refuse_repeated(runs: Sequence[Run]) -> None:
    """Raise InputError if a run is given twice, under one path or two: it would count as a repeat of itself."""
    refuse_duplicates((identity_of(run), run.path) for run in runs)


def refuse_duplicates(runs: Iterable[tuple[str, Path]]) -> None:
    """Raise InputError if two files are of one run; `runs` are the identity and the path of each file."""
    path_of_identity: dict[str, Path] = {}
    for identity, path in runs:
        if identity in path_of_identity:
            raise InputError(f"{path}: the same run as {path_of_identity[identity]}; give each run once")
        path_of_identity[identity] = path


def identity_of(run: Run) -> str:
    """Return a text that two files share if they are the same run: the run's id, else the file's resolved path."""
    return str(run.attributes.get("run_id", "")) or str(run.path.resolve())


def refuse_altered(runs: Sequence[Run]) -> None:
    """Raise InputError if values of a run do not match their checksums: they are not as they were measured."""
    integrity.refuse_altered(run.path for run in runs)


def refuse_unknown(analysis: Experiment, options: dict[str, Any]) -> None:
    """Raise InputError if an analysis does not take one of the options."""
    accepted = options_of(analysis)
    for name in options:
        if name not in accepted:
            accepted_text = ", ".join(accepted) or "nothing"
            raise InputError(f"{analysis.name} has no option {name}; it has {accepted_text} (--set NAME=NUMBER)")


def options_of(analysis: Experiment) -> list[str]:
    """Return the names of the options that an analysis takes."""
    return [name for name in inspect.signature(analysis.analyze).parameters if name != "runs"]
