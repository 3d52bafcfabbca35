"""Find the analysis that a run asks for and apply it; experiment `torque-constant` is the module `torque_constant`.

A module of this package with a function `analyze(runs, **options) -> Result` is an experiment; adding one adds a file.
Its `RESULTS` are every result that it may give, with units, so that a limit on one is checked before a run.
"""

import ast
import importlib
import importlib.util
import inspect
import math
import pkgutil
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import leactl.analysis
from leactl import yamlfile
from leactl.analysis.estimate import Covariance, Estimate, Grid, Plot, Result
from leactl.analysis.quality.gate import doubts_of
from leactl.errors import InputError
from leactl.runfile.integrity import altered
from leactl.runfile.reader import Run

Analysis = Callable[..., Result]


def names() -> list[str]:
    """Experiments that can be analysed."""
    return sorted(module.replace("_", "-") for module in _modules() if _analyzes(module))


def is_known(experiment: str) -> bool:
    """Whether an experiment can be analysed."""
    module = _module_of(experiment)
    return module in _modules() and _analyzes(module)


def analysis_of(experiment: str, place: str) -> Analysis:
    """The function that analyses an experiment.

    Raises
    ------
    InputError : there is none; `place` opens the message.
    """
    if is_known(experiment):
        loaded = importlib.import_module(f"{leactl.analysis.__name__}.{_module_of(experiment)}")
        function: Analysis = loaded.analyze
        return function
    asked = f"analysis '{experiment}' is not known" if experiment else "the run names no analysis"
    raise InputError(f"{place}: {asked}; known: {', '.join(names())}")


def method_of(experiment: str) -> str:
    """How an experiment is analysed, in one sentence: the first of its module."""
    text = inspect.getdoc(inspect.getmodule(analysis_of(experiment, experiment))) or ""
    return " ".join(text.partition("\n\n")[0].split())


@cache
def results_of(experiment: str) -> dict[str, str]:
    """Every result that an experiment may give, with its unit: RESULTS of its module, read without importing it.

    Raises
    ------
    InputError : there is no such experiment.
    """
    if not is_known(experiment):
        analysis_of(experiment, experiment)
    for statement in ast.parse(_text_of(_module_of(experiment))).body:
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "RESULTS":
            declared: dict[str, str] = ast.literal_eval(statement.value)
            return declared
    return {}


def experiment_of(run: Run) -> str:
    """What a run is to be analysed as: `analysis` of its protocol, else the protocol's name; empty if nothing says."""
    return asked_in(run.source("protocol") or "") or str(run.attributes.get("protocol", ""))


def asked_in(protocol: str) -> str:
    """`analysis` of a protocol's text; empty where it has none.

    A text that cannot be read counts as none, since the run may come from elsewhere.
    """
    try:
        data = yamlfile.parse(protocol).data
    except InputError:
        return ""
    named = data.get("analysis") if isinstance(data, dict) else None
    return named if isinstance(named, str) else ""


def analyze_runs(paths: Sequence[Path | str], **options: Any) -> Result:
    """Analyse runs of one experiment: one set of results for each actuator and condition, repeats combined.

    Options that are None count as not given.

    Raises
    ------
    InputError : files that are no runs, hold other values than at their close, are of different experiments, given
        twice, or cannot answer.
    """
    with ExitStack() as opened:
        runs = [opened.enter_context(Run.open(path)) for path in paths]
        if not runs:
            raise InputError("no run to analyse; give one run file or more")
        refuse_repeated(runs)
        refuse_altered(runs)
        doubts = [note for run in runs for note in doubts_of(run)]
        asked = {run.path: experiment_of(run) for run in runs}
        first = asked[runs[0].path]
        for run in runs[1:]:
            if asked[run.path] != first:
                raise InputError(
                    f"{run.path}: its analysis is '{asked[run.path]}', that of {runs[0].path} is '{first}'; "
                    "give runs of one experiment"
                )
        analyze = analysis_of(first, str(runs[0].path))
        given = {name: value for name, value in options.items() if value is not None}
        refuse_unknown(first, analyze, given)
        groups: dict[tuple[str, str], list[Run]] = {}
        for run in runs:
            key = str(run.attributes.get("actuator", "")), str(run.attributes.get("condition", ""))
            groups.setdefault(key, []).append(run)
        with opened_by(doubts):
            answers = {key: analyze(members, **given) for key, members in groups.items()}
        return combined(first, runs, answers, doubts)


@contextmanager
def opened_by(doubts: Sequence[str]) -> Iterator[None]:
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
    experiment: str, runs: Sequence[Run], answers: dict[tuple[str, str], Result], doubts: Sequence[str] = ()
) -> Result:
    """One answer from that of each group, doubts of their channels first; notes say whose they are if of several."""
    results: list[Estimate] = []
    plots: list[Plot] = []
    covariances: list[Covariance] = []
    grids: list[Grid] = []
    notes = [*doubts, *(note for run in runs for note in remarks_on(run))]
    shared = set.intersection(*(set(answer.notes) for answer in answers.values()))
    notes += [note for note in next(iter(answers.values())).notes if note in shared]
    for (actuator, condition), answer in answers.items():
        whose = f"{' '.join(filter(None, (actuator, condition))) or 'unnamed'}: " if len(answers) > 1 else ""
        results += [replace(item, actuator=actuator, condition=condition) for item in answer.results]
        plots += [replace(item, actuator=actuator, condition=condition) for item in answer.plots]
        covariances += [replace(item, actuator=actuator, condition=condition) for item in answer.covariances]
        grids += [replace(item, actuator=actuator, condition=condition) for item in answer.grids]
        notes += [whose + note for note in answer.notes if note not in shared]
    paths = tuple(str(run.path) for run in runs)
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
    seen: dict[str, Path] = {}
    for run in runs:
        identity = str(run.attributes.get("run_id", "")) or str(run.path.resolve())
        if identity in seen:
            raise InputError(f"{run.path}: the same run as {seen[identity]}; give each run once")
        seen[identity] = run.path


def refuse_altered(runs: Sequence[Run]) -> None:
    """Refuse runs whose values are not those of their checksums: figures from them would stand for no measurement."""
    findings = [finding for run in runs for finding in altered(run.path)]
    if findings:
        raise InputError([f"{finding}; nothing is worked out from it" for finding in findings])


def refuse_unknown(experiment: str, analyze: Analysis, options: dict[str, Any]) -> None:
    """Refuse to tell an analysis what it does not ask for."""
    known = [name for name in inspect.signature(analyze).parameters if name != "runs"]
    for name in options:
        if name not in known:
            has = ", ".join(known) or "nothing"
            raise InputError(f"{experiment} cannot be told {name}; it can be told {has} (by --set NAME=NUMBER)")


def _module_of(experiment: str) -> str:
    return experiment.replace("-", "_")


def _modules() -> list[str]:
    """Modules of this package."""
    return [module.name for module in pkgutil.iter_modules(leactl.analysis.__path__)]


@cache
def _analyzes(module: str) -> bool:
    """Whether a module is an experiment, by its text: importing them all takes scipy and a second."""
    return re.search(r"^def analyze\(", _text_of(module), re.MULTILINE) is not None


def _text_of(module: str) -> str:
    spec = importlib.util.find_spec(f"{leactl.analysis.__name__}.{module}")
    return Path(spec.origin).read_text(encoding="utf-8") if spec is not None and spec.origin is not None else ""
