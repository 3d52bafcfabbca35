"""Diagnose every case of a folder and write each answer at once; existing answers are not computed again."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from leactl.errors import InputError
from leactl.gap.diagnose import diagnose, read_case
from leactl.processes import Progress, Workers, each
from leactl.runfile.publish import replacement

MODEL_FILE = "nominal.yaml"  # name of the nominal model in the folder of a case


def case_names(cases: Path) -> list[str]:
    """Return the names of the cases of a folder, each with its nominal model.

    Raises
    ------
    InputError : the folder has no case.
    """
    names = sorted(path.parent.name for path in cases.glob(f"*/{MODEL_FILE}"))
    if not names:
        raise InputError(f"{cases}: no case in it; a folder that `leactl gap blind make` wrote was expected")
    return names


def answer_all(cases: Path, answers: Path, workers: Workers, progress: Progress) -> list[str]:
    """Diagnose the cases that have no answer yet; return the names of all cases.

    The last run of every kind is held out, the default of `leactl gap diagnose`.

    Raises
    ------
    InputError : the folder has no case, or a case cannot be diagnosed.
    """
    names = case_names(cases)
    answers.mkdir(parents=True, exist_ok=True)
    jobs = [(cases / name, answers / f"{name}.json") for name in names if not (answers / f"{name}.json").exists()]
    each(answer, jobs, workers, "diagnosed", progress)
    return names


def answer(case: Path, out: Path) -> None:
    """Diagnose one case and write its answer."""
    write(out, diagnose(read_case(runs_of(case), [], case / MODEL_FILE)).as_json())


def runs_of(case: Path) -> list[Path]:
    """Return the run files of a case."""
    return sorted(case.glob("*.h5"))


def write(out: Path, document: dict[str, Any]) -> None:
    """Write a document as JSON, whole or not at all, so that a stop never leaves half a file."""
    with replacement(out) as path:
        path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read(folder: Path, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the documents of these cases from a folder, by the name of the case."""
    return {name: json.loads((folder / f"{name}.json").read_text(encoding="utf-8")) for name in names}
