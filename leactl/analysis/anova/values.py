"""Values for an analysis of variance: one result of an analysis for each trial, with its actuator and condition.

Some analyses need several passes of the repeats for a result. The values of such results are also collected from whole
runs, one value for each run.
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
Figure = Annotated[float, Field(ge=-1e100, le=1e100)]  # bounded, since its square must be finite


class _Row(BaseModel):
    """One result in an answer, with the fields that are read."""

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
    """An answer of `leactl analyze --json`, with the fields that are read."""

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
    run: npt.NDArray[np.int64]  # trials of one run share one setting of the condition
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
    runs: dict[str, Values]  # one value for each run; empty if the trials of each run have every result


def values_of_runs(paths: Sequence[Path], by_run: bool = False, **options: Any) -> ExperimentValues:
    """Return the values of each result, from runs and from answers of `leactl analyze --json`.

    A run with repeats gives one value for each pass; a run without repeats, and an answer, gives one value. If the
    trials of some run lack a result, each whole run gives one value too.

    Parameters
    ----------
    by_run : whether each run gives one value, from all its repeats together.
    options : of the analysis.

    Raises
    ------
    InputError : no file is given, a file is neither a run nor an answer, is given twice, was altered or has no
        condition, the files are of different experiments, or an option is unknown or given for an answer.
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
    path_of_experiment: dict[str, Path] = {}
    answer_of_run: dict[Path, Path] = {}
    for path in answers:
        experiment_name, answer_trials, answered_runs = _of_answer(path, len(trials))
        path_of_experiment.setdefault(experiment_name, path)
        trials += answer_trials
        for file in answered_runs:
            if file in answer_of_run:
                raise InputError(f"{path}: it is of {file.name}, as {answer_of_run[file]} is; give each run once")
        answer_of_run |= dict.fromkeys(answered_runs, path)
    for path in files:
        if path.resolve() in answer_of_run:
            raise InputError(f"{path}: {answer_of_run[path.resolve()]} is an answer of it; give each run once")
    with ExitStack() as open_files:
        runs = [open_files.enter_context(Run.open(path)) for path in files]
        refuse_repeated(runs)
        refuse_altered(runs)
        for run in runs:
            path_of_experiment.setdefault(experiment_of(run), run.path)
        if len(path_of_experiment) > 1:
            experiments_text = ", ".join(
                f"{path} is '{experiment_name}'" for experiment_name, path in path_of_experiment.items()
            )
            raise InputError(f"different experiments: {experiments_text}; give runs of one experiment")
        first_run_number = len(trials)
        trial_results = joined(
            _of_run(run, number, by_run, options) for number, run in enumerate(runs, start=first_run_number)
        )
        trials_lack_results = (
            not by_run
            and any(len(_repeats(run)) > 1 for run in runs)
            and _lack_results([*trials, *trial_results.value], first_run_number, len(runs))
        )
        runs_to_pool = enumerate(runs if trials_lack_results else [], start=first_run_number)
        whole_runs = joined(_of_run(run, number, True, options) for number, run in runs_to_pool)
    experiment = next(iter(path_of_experiment))
    every_trial, every_run = [*trials, *trial_results.value], [*trials, *whole_runs.value]
    if not every_trial and not (trials_lack_results and every_run):
        raise NotIdentifiable(
            f"{experiment}: no {'run' if by_run else 'trial'} could be analysed: {listed(trial_results.notes, 2)}"
        )
    missing_in_trials = "single trials give no uncertainty of it, or not under every condition"
    reason = missing_in_trials if every_trial else f"no single trial could be analysed ({trial_results.notes[-1]})"
    run_notes = (f"one value a run, its repeats together: {reason}", *whole_runs.notes)
    by_trial = _columns(every_trial, trial_results.notes)
    return ExperimentValues(experiment, by_trial, _columns(every_run, run_notes) if trials_lack_results else {})


def _lack_results(trials: Sequence[TrialResults], first_number: int, count: int) -> bool:
    """Return whether some run has a result that has no uncertainty in any of its trials.

    The runs have the `count` numbers from `first_number` on.
    """
    names = {estimate.name for trial in trials for estimate in trial.results}
    results_with_std = {
        (trial.run, estimate.name) for trial in trials for estimate in trial.results if np.isfinite(estimate.std)
    }
    numbers = range(first_number, first_number + count)
    return any(not names or (run, name) not in results_with_std for run in numbers for name in names or {""})


def _repeats(run: Run) -> list[int]:
    """Return the numbers of the repeats in a run; empty if its steps state none."""
    return sorted({int(step.parameters["repeat"]) for step in run.steps if "repeat" in step.parameters})


def _of_run(run: Run, number: int, by_run: bool, options: dict[str, Any]) -> Noted[list[TrialResults]]:
    """Return the results of each pass of a run's repeats, or of the whole run; a note names passes without a result."""
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
        failed_repeats = listed(repeat for repeat, _ in failures)
        failure_text = f"{len(failures)} of {len(passes)} trials gave nothing ({failed_repeats})"
        summary = failure_text if len(passes) > 1 else "it gave nothing"
        notes.append(f"{run.path}: {summary}: {failures[0][1]}")
    return Noted(trials, tuple(notes))


def _analysed(analysis: Experiment, run: Run, options: dict[str, Any]) -> tuple[Estimate, ...]:
    """Return the estimates of one run."""
    return analysis.answer([run], **options).results


def _of_answer(path: Path, first_number: int) -> tuple[str, list[TrialResults], set[Path]]:
    """Return the experiment, the trials and the paths of the runs of an answer.

    There is one trial for each actuator and condition; their run numbers begin with `first_number`.
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
    numbered_groups = enumerate(groups.items(), start=first_number)
    trials = [TrialResults(*group, number, tuple(estimates)) for number, (group, estimates) in numbered_groups]
    return answer.experiment, trials, {Path(run).resolve() for run in answer.runs}


def experiment_of_answer(path: Path) -> str:
    """Return the experiment of an answer of `leactl analyze --json`.

    Raises
    ------
    InputError : the file is no such answer.
    """
    return _of_answer(path, 0)[0]


def _columns(trials: Sequence[TrialResults], notes: Sequence[str]) -> dict[str, Values]:
    """Return the values of each result that has an uncertainty, by name.

    A result that is part of another result, such as that of one direction, is left out. Its name begins with the name
    of the other result and an underscore.
    """
    units_of_result: dict[str, str] = {}
    for trial in trials:
        for estimate in trial.results:
            is_part_of_another = any(estimate.name.startswith(f"{name}_") for name in units_of_result)
            if np.isfinite(estimate.std) and not is_part_of_another:
                units = units_of_result.setdefault(estimate.name, estimate.units)
                if units != estimate.units:
                    raise InputError(f"{estimate.name} is in {units} and in {estimate.units}; one unit was expected")
    columns = {}
    for name, units in units_of_result.items():
        trial_values = [
            next((estimate.value for estimate in trial.results if estimate.name == name), np.nan) for trial in trials
        ]
        values = np.array(trial_values, np.float64)
        finite = np.isfinite(values)
        column_notes = list(notes)
        if not finite.all():
            column_notes.append(f"{name}: {int((~finite).sum())} of {len(values)} values are missing and left out")
        trials_with_value = [trial for trial, is_finite in zip(trials, finite, strict=True) if is_finite]
        columns[name] = Values(
            name,
            units,
            values[finite],
            np.array([trial.actuator for trial in trials_with_value], np.str_),
            np.array([trial.condition for trial in trials_with_value], np.str_),
            np.array([trial.run for trial in trials_with_value], np.int64),
            tuple(column_notes),
        )
    return columns
