"""Comparisons of the conditions of many runs, experiment by experiment."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leactl.analysis.analyze import analysis_of, by_experiment, options_of
from leactl.analysis.anova.comparison import Comparison, compare_all
from leactl.analysis.anova.values import experiment_of_answer
from leactl.errors import InputError, NotIdentifiable
from leactl.runfile.catalog.summaries import run_files


@dataclass(frozen=True, eq=False)
class ExperimentComparison:
    """Comparisons of the results of one experiment; `refused` has a line for each result that was not compared."""

    experiment: str
    comparisons: list[Comparison]
    refused: list[str]

    def as_json(self) -> dict[str, Any]:
        """Return the comparisons as a JSON object."""
        results = [comparison.as_json() for comparison in self.comparisons]
        return {"experiment": self.experiment, "results": results, "not_compared": self.refused}


def compare_each(
    files_and_folders: Sequence[Path], names: Sequence[str] = (), by_run: bool = False, **options: Any
) -> tuple[list[ExperimentComparison], list[str], list[str]]:
    """Compare the conditions of each experiment; folders stand for their runs.

    Parameters
    ----------
    names, by_run, options : as of `compare_all`; of several experiments each gets the options that it takes.

    Returns
    -------
    A comparison for each experiment that can be compared, a line for each that cannot, and a line for each fault of a
    file.

    Raises
    ------
    InputError : the runs are of one experiment, which cannot be compared; no experiment can be compared; or none of
        several experiments has a result or takes an option.
    """
    paths = [file for path in files_and_folders for file in (run_files([path]) if path.is_dir() else [path])]
    groups, faults = by_experiment([path for path in paths if path.suffix != ".json"])
    for path in paths:
        if path.suffix == ".json":
            groups.setdefault(experiment_of_answer(path), []).append(path)
    if len(groups) < 2 and not faults:
        return [ExperimentComparison(*compare_all(paths, names, by_run, **options))], [], []
    if faults and not groups:
        raise InputError(faults)
    given_options = {name: value for name, value in options.items() if value is not None}
    used_options: set[str] = set()
    compared: list[ExperimentComparison] = []
    uncompared: list[str] = []
    for experiment, members in groups.items():
        try:
            accepted_options = {
                key: given_options[key]
                for key in options_of(analysis_of(experiment, str(members[0])))
                if key in given_options
            }
            used_options |= accepted_options.keys()
            comparison = ExperimentComparison(*compare_all(members, (), by_run, **accepted_options))
        except NotIdentifiable as fault:
            uncompared += [_prefixed(experiment, fault_line) for fault_line in fault.faults]
        except InputError as fault:
            faults += fault.faults
        else:
            compared.append(comparison)
    compared_names = {
        comparison.name for experiment_comparison in compared for comparison in experiment_comparison.comparisons
    }
    option_faults = [
        f"--set {name}: none of {', '.join(groups)} takes it" for name in given_options if name not in used_options
    ]
    option_faults += [
        f"--result {name}: none of {', '.join(groups)} has it to compare"
        for name in names
        if name not in compared_names
    ]
    if option_faults:
        raise InputError(option_faults)
    if names:
        compared = [
            ExperimentComparison(
                group.experiment, [result for result in group.comparisons if result.name in names], group.refused
            )
            for group in compared
        ]
        compared = [comparison for comparison in compared if comparison.comparisons]
    if not compared:
        raise InputError([*faults, *uncompared])
    return compared, uncompared, faults


def _prefixed(experiment: str, fault: str) -> str:
    """Return a fault that begins with the name of its experiment."""
    return fault if fault.startswith(f"{experiment}: ") else f"{experiment}: {fault}"
