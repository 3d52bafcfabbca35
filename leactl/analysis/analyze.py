"""Find the analysis that a run asks for and apply it."""

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from leactl.analysis.estimate import Covariance, Estimate, Grid, Plot, Result
from leactl.analysis.quality.gate import channel_doubts
from leactl.analysis.registry import GENERIC, Experiment, load, names
from leactl.errors import InputError
from leactl.processes import HERE, Workers
from leactl.runfile.catalog.summaries import analysis_in
from leactl.runfile.read.reader import Run
from leactl.runfile.verify import integrity

__all__ = ["GENERIC", "Experiment", "analyze_runs", "names"]


def is_known(experiment: str) -> bool:
    """Whether an experiment can be analysed."""
    return experiment.replace("_", "-") in names()


def analysis_of(experiment: str, place: str) -> Experiment:
    """The experiment of this name.

    Raises
    ------
    InputError : there is none, or it cannot be used; `place` opens the message.
    """
    try:
        return load(experiment)
    except InputError as fault:
        raise InputError(f"{place}: {fault}") from None


def method_of(experiment: str) -> str:
    """How an experiment is analysed, in one sentence."""
    return load(experiment).method


def results_of(experiment: str) -> dict[str, str]:
    """Every result that an experiment may give, with its unit.

    Raises
    ------
    InputError : there is no such experiment.
    """
    return dict(load(experiment).results)


def experiment_of(run: Run) -> str:
    """What a run is to be analysed as: `analysis` of its protocol, else its protocol's name, else by its channels."""
    asked = analysis_in(run.source("protocol") or "")
    protocol = str(run.attributes.get("protocol", ""))
    return asked or (protocol if is_known(protocol) else GENERIC)


@dataclass(frozen=True)
class InspectedRun:
    """What has to be known of a run before it is analysed together with others."""

    path: Path
    identity: str  # of two files that are the same run
    group: tuple[str, str]  # its actuator and its condition
    experiment: str
    altered: list[str]  # what is not as it was at its close
    unread: list[str]  # why its channels cannot be looked at
    doubts: list[str]
    condemned: dict[str, str]  # as of `Run.condemned`
    remarks: list[str]


Groups = Sequence[Sequence[InspectedRun]]  # runs of one actuator under one condition each
Answers = Callable[[Experiment, Groups, dict[str, Any]], Iterator[Result]]


def inspect_run(run: Run, experiment: str) -> InspectedRun:
    """Look at a run by itself.

    Parameters
    ----------
    experiment : what it is analysed as; what it asks for itself by default.
    """
    doubts: list[str] = []
    unread: list[str] = []
    altered = integrity.altered(run.path)
    if not altered:
        try:
            doubts = channel_doubts(run)
        except InputError as fault:  # which is the fault of all that it is analysed with
            unread = fault.faults
    group = str(run.attributes.get("actuator", "")), str(run.attributes.get("condition", ""))
    asked = experiment or experiment_of(run)
    return InspectedRun(
        run.path, identity_of(run), group, asked, altered, unread, doubts, run.condemned, remarks_on(run)
    )


def analyze_runs(paths: Sequence[Path | str], experiment: str = "", **options: Any) -> Result:
    """Analyse runs of one experiment: one set of results for each actuator and condition, repeats combined.

    Parameters
    ----------
    experiment : what to analyse them as; what the runs themselves ask for by default.
    options : for the analysis; those that are None count as not given.

    Raises
    ------
    InputError : files that are no runs, hold other values than at their close, are of different experiments, given
        twice, or cannot answer.
    """
    with ExitStack() as opened:
        runs = {run.path: run for run in [opened.enter_context(Run.open(path)) for path in paths]}

        def answers(
            analysis: Experiment, groups: Sequence[Sequence[InspectedRun]], given: dict[str, Any]
        ) -> Iterator[Result]:
            yield from (analysis.answer([runs[one.path] for one in members], **given) for members in groups)

        return analyzed([inspect_run(runs[Path(path)], experiment) for path in paths], answers, options)


def analyzed(vetted: Sequence[InspectedRun], answers: Answers, options: Mapping[str, Any]) -> Result:
    """The answer of runs that were looked at one by one.

    Parameters
    ----------
    answers : gives that of each group of runs.

    Raises
    ------
    InputError : as of `analyze_runs`.
    """
    if not vetted:
        raise InputError("no run to analyse; give one run file or more")
    refuse_the_same((one.identity, one.path) for one in vetted)
    integrity.refuse_findings([finding for one in vetted for finding in one.altered])
    if unread := next((one.unread for one in vetted if one.unread), []):
        raise InputError(unread)
    first = vetted[0]
    for one in vetted:
        if one.experiment != first.experiment:
            raise InputError(
                f"{one.path}: its analysis is '{one.experiment}', that of {first.path} is '{first.experiment}'; "
                "give runs of one experiment"
            )
    analysis = analysis_of(first.experiment, str(first.path))
    given = {name: value for name, value in options.items() if value is not None}
    refuse_unknown(analysis, given)
    groups: dict[tuple[str, str], list[InspectedRun]] = {}
    for one in vetted:
        groups.setdefault(one.group, []).append(one)
    doubts = [note for one in vetted for note in one.doubts]
    with prefixed_by(doubts):
        found = dict(zip(groups, answers(analysis, list(groups.values()), given), strict=True))
    return combined(first.experiment, vetted, found, doubts)


def analyze_each(
    paths: Sequence[Path], experiment: str = "", workers: Workers = HERE, **options: Any
) -> tuple[list[Result], list[str]]:
    """Analyse runs experiment by experiment, in the order in which each first appears.

    Parameters
    ----------
    experiment, options : as of `analyze_runs`; of several experiments each gets the options that it takes.
    workers : who looks at the runs, and then answers for each actuator and condition; the answer does not depend on it.

    Returns
    -------
    A result for each experiment that could be analysed, and a line for each fault of the others.

    Raises
    ------
    InputError : the runs are of one experiment, which cannot be analysed, or an option that none of several takes.
    """
    experiments: dict[str, list[InspectedRun]] = {}
    faults: list[str] = []
    for done in workers.in_order(_vetted, [(path, experiment) for path in paths]):
        faults += done.faults
        if not done.faults:
            experiments.setdefault(done.value().experiment, []).append(done.value())

    def answers(
        analysis: Experiment, groups: Sequence[Sequence[InspectedRun]], given: dict[str, Any]
    ) -> Iterator[Result]:
        jobs = [(analysis.name, [(one.path, one.condemned) for one in members], given) for members in groups]
        yield from (done.value() for done in workers.in_order(_answer, jobs))

    if faults and not experiments:  # and so nothing that an option could be for
        return [], faults
    if len(experiments) == 1 and not faults:
        return [analyzed(members, answers, options) for members in experiments.values()], []
    given = {name: value for name, value in options.items() if value is not None}
    results: list[Result] = []
    taken: set[str] = set()
    for name, members in experiments.items():
        try:
            own = {key: given[key] for key in options_of(analysis_of(name, str(members[0].path))) if key in given}
            taken |= own.keys()
            results.append(analyzed(members, answers, own))
        except InputError as fault:
            faults += fault.faults
    if untaken := [key for key in given if key not in taken]:
        raise InputError([f"--set {key}: none of {', '.join(experiments)} takes it" for key in untaken])
    return results, faults


def _vetted(path: Path, experiment: str) -> InspectedRun:
    with Run.open(path) as run:
        return inspect_run(run, experiment)


def _answer(experiment: str, members: Sequence[tuple[Path, dict[str, str]]], given: dict[str, Any]) -> Result:
    with ExitStack() as opened:
        runs = [opened.enter_context(Run.open(path)) for path, _ in members]
        for run, (_, condemned) in zip(runs, members, strict=True):
            run.condemned = condemned
        return load(experiment).answer(runs, **given)


def by_experiment(paths: Sequence[Path], experiment: str = "") -> tuple[dict[str, list[Path]], list[str]]:
    """Return the runs of each experiment, and a line for each file that is no run; `experiment` stands for all."""
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
def prefixed_by(doubts: Sequence[str]) -> Iterator[None]:
    """Let the doubts of the channels open what an analysis is refused with: they are likely why."""
    try:
        yield
    except InputError as fault:
        if not doubts or fault.faults[0] in doubts:
            raise
        raise type(fault)(["; ".join([*doubts, fault.faults[0]]), *fault.faults[1:]]) from fault


def numbers(settings: Sequence[str], **given: float | None) -> dict[str, float]:
    """What an analysis is told, from `name=number` each and from options of their own, which are None if not given.

    Raises
    ------
    InputError : one line for each that is not so, or is there twice.
    """
    faults, found = [], {name: value for name, value in given.items() if value is not None}
    for setting in settings:
        name, _, text = (part.strip() for part in setting.partition("="))
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (name.isidentifier() and math.isfinite(value)):
            faults.append(f"--set {setting}: name=number was expected")
        elif name in found:
            faults.append(f"--set {name}: given twice")
        else:
            found[name] = value
    if faults:
        raise InputError(faults)
    return found


def combined(
    experiment: str, vetted: Sequence[InspectedRun], answers: dict[tuple[str, str], Result], doubts: Sequence[str] = ()
) -> Result:
    """One answer from that of each group, doubts of their channels first; notes say whose they are if of several."""
    results: list[Estimate] = []
    plots: list[Plot] = []
    covariances: list[Covariance] = []
    grids: list[Grid] = []
    notes = [*doubts, *(note for one in vetted for note in one.remarks)]
    shared = set.intersection(*(set(answer.notes) for answer in answers.values()))
    notes += [note for note in next(iter(answers.values())).notes if note in shared]
    for (actuator, condition), answer in answers.items():
        whose = f"{' '.join(filter(None, (actuator, condition))) or 'unnamed'}: " if len(answers) > 1 else ""
        results += [replace(item, actuator=actuator, condition=condition) for item in answer.results]
        plots += [replace(item, actuator=actuator, condition=condition) for item in answer.plots]
        covariances += [replace(item, actuator=actuator, condition=condition) for item in answer.covariances]
        grids += [replace(item, actuator=actuator, condition=condition) for item in answer.grids]
        notes += [whose + note for note in answer.notes if note not in shared]
    paths = tuple(str(one.path) for one in vetted)
    return Result(
        experiment, paths, tuple(results), tuple(dict.fromkeys(notes)), tuple(plots), tuple(covariances), tuple(grids)
    )


def remarks_on(run: Run) -> list[str]:
    """What a reader must know of a run that did not come to its end."""
    if run.status in ("complete", ""):
        return []
    reason = str(run.attributes.get("status_reason", ""))
    why = f" ({reason})" if reason else ""
    return [f"{run.path}: status is '{run.status}'{why}; analysed as far as its steps go"]


def refuse_repeated(runs: Sequence[Run]) -> None:
    """Refuse a run that is there twice, under one path or two: it would count as a repeat of itself."""
    refuse_the_same((identity_of(run), run.path) for run in runs)


def refuse_the_same(runs: Iterable[tuple[str, Path]]) -> None:
    """Refuse files that are the same by what they go by."""
    seen: dict[str, Path] = {}
    for identity, path in runs:
        if identity in seen:
            raise InputError(f"{path}: the same run as {seen[identity]}; give each run once")
        seen[identity] = path


def identity_of(run: Run) -> str:
    """What tells whether two files are the same run."""
    return str(run.attributes.get("run_id", "")) or str(run.path.resolve())


def refuse_altered(runs: Sequence[Run]) -> None:
    """Refuse runs whose values are not those of their checksums: figures from them would stand for no measurement."""
    integrity.refuse_altered(run.path for run in runs)


def refuse_unknown(analysis: Experiment, options: dict[str, Any]) -> None:
    """Refuse to tell an analysis what it does not ask for."""
    known = options_of(analysis)
    for name in options:
        if name not in known:
            has = ", ".join(known) or "nothing"
            raise InputError(f"{analysis.name} cannot be told {name}; it can be told {has} (by --set NAME=NUMBER)")


def options_of(analysis: Experiment) -> list[str]:
    """What an analysis can be told."""
    return [name for name in inspect.signature(analysis.analyze).parameters if name != "runs"]
