"""Comparisons of many runs, experiment by experiment, as `leactl analyze` takes them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leactl.analysis.analyze import analysis_of, by_experiment, options_of
from leactl.analysis.anova.comparison import Comparison, compare_all
from leactl.analysis.anova.values import experiment_of_answer
from leactl.errors import InputError, NotIdentifiable
from leactl.runfile.catalog import run_files


@dataclass(frozen=True, eq=False)
class ExperimentComparison:
    """The results of one experiment over its conditions, and why others were not compared."""

    experiment: str
    found: list[Comparison]
    refused: list[str]

    def as_json(self) -> dict[str, Any]:
        """All of it for a script."""
        results = [one.as_json() for one in self.found]
        return {"experiment": self.experiment, "results": results, "not_compared": self.refused}


def compare_each(
    given: Sequence[Path], names: Sequence[str] = (), by_run: bool = False, **options: Any
) -> tuple[list[ExperimentComparison], list[str], list[str]]:
    """Compare the conditions of each experiment; folders stand for their runs.

    Parameters
    ----------
    names, by_run, options : as of `compare_all`; of several experiments each gets the options that it takes.

    Returns
    -------
    A comparison for each experiment that has one, a line for each that has none, and a line for each fault of a file.

    Raises
    ------
    InputError : the runs are of one experiment, which cannot be compared; nothing can; or a result or an option that
        none of several experiments has.
    """
    paths = [file for path in given for file in (run_files([path]) if path.is_dir() else [path])]
    groups, faults = by_experiment([path for path in paths if path.suffix != ".json"])
    for path in paths:
        if path.suffix == ".json":
            groups.setdefault(experiment_of_answer(path), []).append(path)
    if len(groups) < 2 and not faults:
        return [ExperimentComparison(*compare_all(paths, names, by_run, **options))], [], []
    if faults and not groups:
        raise InputError(faults)
    told = {name: value for name, value in options.items() if value is not None}
    taken: set[str] = set()
    compared: list[ExperimentComparison] = []
    without: list[str] = []
    for experiment, members in groups.items():
        try:
            own = {key: told[key] for key in options_of(analysis_of(experiment, str(members[0]))) if key in told}
            taken |= own.keys()
            one = ExperimentComparison(*compare_all(members, (), by_run, **own))
        except NotIdentifiable as fault:
            without += [_of(experiment, line) for line in fault.faults]
        except InputError as fault:
            faults += fault.faults
        else:
            compared.append(one)
    has = {one.name for each in compared for one in each.found}
    lines = [f"--set {name}: none of {', '.join(groups)} takes it" for name in told if name not in taken]
    lines += [f"--result {name}: none of {', '.join(groups)} has it to compare" for name in names if name not in has]
    if lines:
        raise InputError(lines)
    if names:
        compared = [
            ExperimentComparison(o.experiment, [r for r in o.found if r.name in names], o.refused) for o in compared
        ]
        compared = [one for one in compared if one.found]
    if not compared:
        raise InputError([*faults, *without])
    return compared, without, faults


def _of(experiment: str, line: str) -> str:
    return line if line.startswith(f"{experiment}: ") else f"{experiment}: {line}"
