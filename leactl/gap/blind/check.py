"""The check as a whole: answers first, then the key, then the marks."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from leactl.errors import InputError
from leactl.gap.blind.answers import answer_all, read
from leactl.gap.blind.marks import Mark, mark
from leactl.gap.blind.pool import Progress, each
from leactl.gap.blind.truth import Truth, measure

OpenKey = Callable[[], Mapping[str, Any]]


def check(cases: Path, answers: Path, open_key: OpenKey, processes: int, progress: Progress) -> list[Mark]:
    """Diagnose every case, and only then open the key and mark the answers.

    Parameters
    ----------
    answers : folder for the answers; what stands there is not done again. What the key makes measurable stands beside,
        under `told`.
    open_key : reads and checks the key.

    Raises
    ------
    InputError : cases that cannot be diagnosed, or a key that is not theirs.
    """
    names = answer_all(cases, answers, processes, progress)
    entries = open_key()["cases"]
    missing = [f"{cases / name}: the key has no such case" for name in names if name not in entries]
    if missing:
        raise InputError(missing)
    told = answers / "told"
    told.mkdir(exist_ok=True)
    left = [name for name in names if not (told / f"{name}.json").exists()]
    jobs = [(cases / name, entries[name], told / f"{name}.json") for name in left]
    each(measure, jobs, processes, "told the truth", progress)
    given, measured = read(answers, names), read(told, names)
    return [mark(name, Truth.of(entries[name]), given[name], measured[name]) for name in names]
