"""Run the check on withheld causes: answers first, then the key, then the marks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from leactl.errors import InputError
from leactl.gap.blind.answers import answer_all, case_names, read
from leactl.gap.blind.marks import Mark, mark
from leactl.gap.blind.truth import Truth, measure
from leactl.processes import Progress, Workers, each

OpenKey = Callable[[], Mapping[str, Any]]
ReadKey = Callable[[Path, Path], Mapping[str, Any]]


@dataclass(frozen=True)
class Cases:
    """One set of cases: folders of its runs, its key and its answers."""

    runs: Path
    key: Path  # a folder apart from the runs
    answers: Path  # existing answers are not computed again; measurements with the key are in its folder `told`

    @classmethod
    def side_by_side(cls, runs: Sequence[Path], keys: Sequence[Path], answers: Sequence[Path]) -> list[Self]:
        """Return sets of cases from folders that are given in the same order; by default answers go next to the runs.

        Raises
        ------
        InputError : the numbers of folders differ, or two sets would have their answers in one folder.
        """
        if len(keys) != len(runs):
            raise InputError(f"--key: found {len(keys)} for {len(runs)} of --cases; give one for each, in their order")
        answer_folders = list(answers) or [folder.with_name(f"{folder.name}-answers") for folder in runs]
        if len(answer_folders) != len(runs):
            raise InputError(
                f"--answers: found {len(answer_folders)} for {len(runs)} of --cases; give one for each or none"
            )
        if len({folder.resolve() for folder in answer_folders}) < len(answer_folders):
            raise InputError("--answers: one folder for two sets of cases; give each its own")
        return [cls(*folders) for folders in zip(runs, keys, answer_folders, strict=True)]


def check(sets: Sequence[Cases], read_key: ReadKey, workers: Workers, progress: Progress) -> list[Mark]:
    """Diagnose every case of every set, and only then open the keys and mark the answers.

    Parameters
    ----------
    read_key : reads and checks a key, from its folder and the one of the runs.

    Raises
    ------
    InputError : a case cannot be diagnosed, or a key does not belong to the cases.
    """
    for cases in sets:
        answer_all(cases.runs, cases.answers, workers, progress)
    marks: list[Mark] = []
    for cases in sets:
        prefix = f"{cases.runs.name}/" if len(sets) > 1 else ""
        marks += marks_of(cases, prefix, read_key(cases.key, cases.runs)["cases"], workers, progress)
    return marks


def marks_of(cases: Cases, prefix: str, entries: Mapping[str, Any], workers: Workers, progress: Progress) -> list[Mark]:
    """Return the marks of the answers of one set of cases, by the entries of its key.

    Raises
    ------
    InputError : the key lacks a case, or a case cannot be measured.
    """
    names = case_names(cases.runs)
    missing = [f"{cases.runs / name}: the key has no such case" for name in names if name not in entries]
    if missing:
        raise InputError(missing)
    truth_folder = cases.answers / "told"
    truth_folder.mkdir(exist_ok=True)
    unmeasured = [name for name in names if not (truth_folder / f"{name}.json").exists()]
    jobs = [(cases.runs / name, entries[name], truth_folder / f"{name}.json") for name in unmeasured]
    each(measure, jobs, workers, "told the truth", progress)
    answers, measured = read(cases.answers, names), read(truth_folder, names)
    return [mark(f"{prefix}{name}", Truth.of(entries[name]), answers[name], measured[name]) for name in names]
