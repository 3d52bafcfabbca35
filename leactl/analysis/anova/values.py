"""Values for an analysis of variance: one result of an analysis for each trial, with its actuator and condition.

Some analyses need more than one pass of the repeats, for one result or for all. The values of such results are also
collected from whole runs, one for each run.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from leactl.analysis.analyze import (
    Experiment,
    analysis_of,
    experiment_of,
    refuse_altered,
    refuse_repeated,
    refuse_unknown,
    remarks_on,
)
from leactl.analysis.estimate import Estimate, Noted, joined, listed
from leactl.analysis.quality.channel_plausibility import channel_doubts
from leactl.errors import InputError, NotIdentifiable
from leactl.regular_files import open_regular
from leactl.runfile.read.reader import Run, Step

Array = npt.NDArray[np.float64]
MOST_ANSWER_BYTES = 1 << 26  # an answer of 50 runs has 200 kB
Figure = Annotated[float, Field(ge=-1e100, le=1e100)]  # its square must be finite


class _Row(BaseModel):
    """The fields that are read of one result in an answer."""

    model_config = ConfigDict(strict=True)
    name: str
    units: str
    value: Figure | None
    std: Figure | None
    low: Figure | None
    high: Figure | None
    actuator: str = ""
    condition: str = ""


class _Answer(BaseModel):
    """The fields that are read of an answer of `leactl analyze --json`."""

    model_config = ConfigDict(strict=True)
    experiment: str
    runs: list[str]
    results: list[_Row]


@dataclass(frozen=True, eq=False)
class Values:
    """Values of one result; element k of each array belongs to trial k, or to run k."""

    name: str
    units: str
    value: Array
    actuator: npt.NDArray[np.str_]
    condition: npt.NDArray[np.str_]
    run: npt.NDArray[np.int64]  # trials of one run have one setting of the condition in common
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class TrialResults:
    """Results of one trial, with its actuator, condition and run number."""

    actuator: str
    condition: str
    run: int
    results: tuple[Estimate, ...]


class _OneTrial(Run):
    """A run that shows only the steps of one repeat."""

    def __init__(self, run: Run, repeat: int) -> None:
        self.__dict__.update(run.__dict__)
        self._repeat = repeat

    @property
    def steps(self) -> list[Step]:
        """Return the steps of this repeat, and those that belong to no repeat."""
        return [step for step in super().steps if step.parameters.get("repeat", self._repeat) == self._repeat]


@dataclass(frozen=True, eq=False)
class ExperimentValues:
    """Values of an experiment's results by name, from single trials and from whole runs."""

    experiment: str
    trials: dict[str, Values]
    runs: dict[str, Values]  # one for each run; empty if the trials of each run have every result


def values_of_runs(paths: Sequence[Path], by_run: bool = False, **options: Any) -> ExperimentValues:
    """Return the values of each result, from runs and from answers of `leactl analyze --json`.

    A run with repeats gives one value for each pass; a run without repeats, and an answer, gives one value. If the
    trials of some run lack a result, each whole run gives one value too.

    Parameters
    ----------
    by_run : take each run as one value, all its repeats together.
    options : of the analysis.

    Raises
    ------
    InputError : a file is neither a run nor an answer, is given twice, was altered or has no condition, or the files
        are of different experiments.
    NotIdentifiable : neither a trial nor a whole run could be analysed.
    """
    answers = [path for path in paths if path.suffix == ".json"]
    files = [path for path in paths if path.suffix != ".json"]
    given_options = listed(name for name, value in options.items() if value is not None)
    if answers and given_options:
        raise InputError(f"{answers[0]}: an answer is analysed already and takes no {given_options}; give runs")
    if not paths:
        raise InputError("nothing to compare; give run files, or answers of `leactl analyze --json`")
    trials: list[TrialResults] = []
    kinds: dict[str, Path] = {}
    answer_of_run: dict[Path, Path] = {}
    for path in answers:
        kind, answer_trials, answered_runs = _of_answer(path, len(trials))
        kinds.setdefault(kind, path)
        trials += answer_trials
        for file in answered_runs:
            if file in answer_of_run:
                raise InputError(f"{path}: it is of {file.name}, as {answer_of_run[file]} is; give each run once")
        answer_of_run |= dict.fromkeys(answered_runs, path)
    for path in files:
        if path.resolve() in answer_of_run:
            raise InputError(f"{path}: {answer_of_run[path.resolve()]} is an answer of it; give each run once")
    with ExitStack() as opened:
        runs = [opened.enter_context(Run.open(path)) for path in files]
        refuse_repeated(runs)
        refuse_altered(runs)
        for run in runs:
            kinds.setdefault(experiment_of(run), run.path)
        if len(kinds) > 1:
            files_by_kind = ", ".join(f"{path} is '{kind}'" for kind, path in kinds.items())
            raise InputError(f"different experiments: {files_by_kind}; give runs of one experiment")
        first_number = len(trials)  # of the first run
        single = joined(_of_run(run, number, by_run, options) for number, run in enumerate(runs, start=first_number))
        trials_lack_results = (
            not by_run
            and any(len(_repeats(run)) > 1 for run in runs)
            and _lack_results([*trials, *single.value], first_number, len(runs))
        )
        analysed_whole = enumerate(runs if trials_lack_results else [], start=first_number)
        whole_runs = joined(_of_run(run, number, True, options) for number, run in analysed_whole)
    experiment = next(iter(kinds))
    every_trial, every_run = [*trials, *single.value], [*trials, *whole_runs.value]
    if not every_trial and not (trials_lack_results and every_run):
        raise NotIdentifiable(
            f"{experiment}: no {'run' if by_run else 'trial'} could be analysed: {listed(single.notes, 2)}"
        )
    missing_in_trials = "single trials give no uncertainty of it, or not under every condition"
    reason = missing_in_trials if every_trial else f"no single trial could be analysed ({single.notes[-1]})"
    run_notes = (f"one value a run, its repeats together: {reason}", *whole_runs.notes)
    by_trial = _columns(every_trial, single.notes)
    return ExperimentValues(experiment, by_trial, _columns(every_run, run_notes) if trials_lack_results else {})


def _lack_results(trials: Sequence[TrialResults], first_number: int, count: int) -> bool:
    """Return whether some run has a result without an uncertainty in all its trials.

    The runs are the `count` ones from number `first_number` on.
    """
    names = {item.name for trial in trials for item in trial.results}
    with_std = {(trial.run, item.name) for trial in trials for item in trial.results if np.isfinite(item.std)}
    numbers = range(first_number, first_number + count)
    return any(not names or (run, name) not in with_std for run in numbers for name in names or {""})


def _repeats(run: Run) -> list[int]:
    """Return the numbers of the repeats in a run; empty where its steps state none."""
    return sorted({int(step.parameters["repeat"]) for step in run.steps if "repeat" in step.parameters})


def _of_run(run: Run, number: int, by_run: bool, options: dict[str, Any]) -> Noted[list[TrialResults]]:
    """Analyse each pass of a run's repeats, or the whole run; a note names the passes that give no result."""
    experiment = experiment_of(run)
    analysis = analysis_of(experiment, str(run.path))
    given_options = {name: value for name, value in options.items() if value is not None}
    refuse_unknown(analysis, given_options)
    actuator, condition = (str(run.attributes.get(name, "")) for name in ("actuator", "condition"))
    if not condition:
        raise InputError(f"{run.path}: the run has no condition; `leactl run --condition` names it")
    notes = [*channel_doubts(run), *remarks_on(run)]
    repeats = _repeats(run)
    passes = [run] if by_run or len(repeats) < 2 else [_OneTrial(run, repeat) for repeat in repeats]
    trials, failures = [], []
    for repeat, one_pass in zip(repeats or [1], passes, strict=False):
        try:
            trials.append(TrialResults(actuator, condition, number, _analysed(analysis, one_pass, given_options)))
        except NotIdentifiable as fault:
            failures.append((repeat, str(fault).removeprefix(f"{run.path}: ")))
    if failures:
        failed = listed(repeat for repeat, _ in failures)
        count = f"{len(failures)} of {len(passes)} trials gave nothing ({failed})"
        summary = count if len(passes) > 1 else "it gave nothing"
        notes.append(f"{run.path}: {summary}: {failures[0][1]}")
    return Noted(trials, tuple(notes))


def _analysed(analysis: Experiment, run: Run, options: dict[str, Any]) -> tuple[Estimate, ...]:
    return analysis.answer([run], **options).results


def _of_answer(path: Path, first_number: int) -> tuple[str, list[TrialResults], set[Path]]:
    """Return experiment, trials and runs of an answer.

    It has one trial for each actuator and condition; these are numbered from `first_number` on.
    """
    try:
        with open_regular(path, MOST_ANSWER_BYTES) as stream:
            answer = _Answer.model_validate_json(stream.read())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValidationError:
        raise InputError(f"{path}: an answer of `leactl analyze --json` was expected") from None
    groups: dict[tuple[str, str], list[Estimate]] = {}
    for row in answer.results:
        value, std, low, high = (
            np.nan if number is None else number for number in (row.value, row.std, row.low, row.high)
        )
        groups.setdefault((row.actuator, row.condition), []).append(
            Estimate(row.name, value, std, low, high, row.units)
        )
    if any(not condition for _, condition in groups):
        raise InputError(f"{path}: its rows name no condition, as where one group was analysed; give the runs")
    pairs = enumerate(groups.items(), start=first_number)
    trials = [TrialResults(*group, number, tuple(estimates)) for number, (group, estimates) in pairs]
    return answer.experiment, trials, {Path(run).resolve() for run in answer.runs}


def experiment_of_answer(path: Path) -> str:
    """Return the experiment of an answer of `leactl analyze --json`.

    Raises
    ------
    InputError : the file is no such answer.
    """
    return _of_answer(path, 0)[0]


def _columns(trials: Sequence[TrialResults], notes: Sequence[str]) -> dict[str, Values]:
    """Collect the values of each result that has an uncertainty.

    Results that are part of another one, such as those of one direction, are left out: their name begins with its name.
    """
    units_of_result: dict[str, str] = {}
    for trial in trials:
        for item in trial.results:
            is_part = any(item.name.startswith(f"{name}_") for name in units_of_result)
            if np.isfinite(item.std) and not is_part:
                units = units_of_result.setdefault(item.name, item.units)
                if units != item.units:
                    raise InputError(f"{item.name} is in {units} and in {item.units}; one unit was expected")
    columns = {}
    for name, units in units_of_result.items():
        by_trial = [next((item.value for item in trial.results if item.name == name), np.nan) for trial in trials]
        values = np.array(by_trial, np.float64)
        finite = np.isfinite(values)
        column_notes = list(notes)
        if not finite.all():
            column_notes.append(f"{name}: {int((~finite).sum())} of {len(values)} values are missing and left out")
        with_value = [trial for trial, is_finite in zip(trials, finite, strict=True) if is_finite]
        columns[name] = Values(
            name,
            units,
            values[finite],
            np.array([trial.actuator for trial in with_value], np.str_),
            np.array([trial.condition for trial in with_value], np.str_),
            np.array([trial.run for trial in with_value], np.int64),
            tuple(column_notes),
        )
    return columns
