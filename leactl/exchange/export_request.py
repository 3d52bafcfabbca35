"""Export an augmented model for another simulator: all files at once or none."""

import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leactl.errors import InputError
from leactl.exchange.callbacks import callbacks
from leactl.exchange.destinations import CALLBACKS, NOWHERE
from leactl.exchange.robot_patch import Patch, patch, write_patch
from leactl.exchange.table import actuator_table
from leactl.gap.replay.bench_of_model import plant_of
from leactl.model.nominal import read_model
from leactl.runfile.publish import new_file, refuse_existing


@dataclass(frozen=True)
class ExportRequest:
    """The arguments of `leactl model export`."""

    model: Path
    to: str  # format: mjcf, urdf or json
    into: Path | None = None
    joint: str | None = None
    out: Path | None = None
    callbacks: Path | None = None
    timestep: float | None = None
    ctrl_is_current: bool = False

    def check(self) -> None:
        """Raise InputError if options exclude each other, one is missing, or an output file cannot be made.

        Raises
        ------
        InputError : one line for each fault.
        """
        options = {
            "--into": self.into,
            "--out": self.out,
            "--callbacks": self.callbacks,
            "--timestep": self.timestep,
            "--ctrl current": self.ctrl_is_current or None,
        }
        needed = {"mjcf": ["--into", "--out"], "urdf": ["--into", "--out"], "json": []}[self.to]
        allowed = {"mjcf": ["--callbacks", "--ctrl current"], "urdf": [], "json": ["--out", "--timestep"]}[self.to]
        faults = [f"--to {self.to} needs {name}" for name in needed if options[name] is None]
        faults += [
            f"{name} does not go with --to {self.to}"
            for name, value in options.items()
            if value is not None and name not in (*needed, *allowed)
        ]
        refuse_unusable_outputs((self.out, self.callbacks), self.callbacks, faults)


def refuse_unusable_outputs(
    files: Iterable[Path | None], code_file: Path | None, other_faults: Sequence[str] = ()
) -> None:
    """Raise InputError if new files cannot have these names; no file is ever overwritten.

    Parameters
    ----------
    code_file : the file of callbacks, whose name must end in .py.
    other_faults : faults that are reported with those of the files.

    Raises
    ------
    InputError : a folder does not exist, a file exists, two files have one name, or the name of the callbacks does not
        end in .py; one line each.
    """
    new_files = [path for path in files if path is not None]
    faults = [*other_faults, *(f"{path}: no folder {path.parent}" for path in new_files if not path.parent.is_dir())]
    if code_file is not None and code_file.suffix != ".py":
        faults.append(f"--callbacks {code_file}: a file named .py was expected")
    if len({path.resolve() for path in new_files}) < len(new_files):
        faults.append(f"{new_files[0]}: is named for two outputs; give each a file of its own")
    if faults:
        raise InputError(faults)
    for path in new_files:
        refuse_existing(path)


@dataclass(frozen=True)
class Exported:
    """Files of an export, or its text, and a summary for the user."""

    written: tuple[Path, ...]
    patched: Patch | None
    text: str | None  # of a table that is not written to a file; None otherwise
    lines: tuple[str, ...]  # summary of changes, effects and notes

    def as_json(self) -> dict[str, Any]:
        """Return files, changes, effects and notes as JSON values."""
        changes = {"changes": [], "effects": [], "notes": []} if self.patched is None else self.patched.as_json()
        return {"written": [str(path) for path in self.written]} | changes


def export(request: ExportRequest) -> Exported:
    """Write a model for another simulator, or return it as the text of a table.

    Raises
    ------
    InputError : a file that cannot be used, arguments that exclude each other, or a joint that the model does not fit.
    """
    request.check()
    model, document = read_model(request.model)
    plant_of(model)  # raises InputError for effects that lack a parameter
    joint = request.joint or model.name
    if request.to == "json":
        text = json.dumps(actuator_table(model, joint, request.timestep), indent=2)
        if request.out is None:
            return Exported((), None, text, ())
        with new_file(request.out) as path:
            path.write_text(text + "\n", encoding="utf-8")
        return Exported((request.out,), None, None, ())
    assert request.into is not None and request.out is not None
    patched = patch(model, request.into, joint, request.to, request.ctrl_is_current)
    callbacks_text = (
        callbacks(model, patched, Path(document.name), request.into, request.out) if request.callbacks else ""
    )
    write_all(patched, request.out, {} if request.callbacks is None else {request.callbacks: callbacks_text})
    written = tuple(path for path in (request.out, request.callbacks) if path is not None)
    return Exported(written, patched, None, tuple(_summary_lines(patched, request.callbacks)))


def write_all(patched: Patch, out: Path, companion_texts: Mapping[Path, str]) -> None:
    """Write a patched file and the texts of other files: all of them or none.

    Raises
    ------
    InputError : MuJoCo reads other figures from the patched file than were written, or a file exists.
    """
    with ExitStack() as files:
        for path, text in companion_texts.items():
            files.enter_context(new_file(path)).write_text(text, encoding="utf-8")
        write_patch(patched, out)


def _summary_lines(patched: Patch, callbacks_file: Path | None) -> list[str]:
    """Return a line for each change, each effect and each note."""
    lines = []
    for change in patched.changes:
        after_text = "removed" if change.after is None else f"{change.before or 'not given'} -> {change.after}"
        lines.append(f"line {change.line}: {change.element}: {change.attribute} {after_text}")
    for destination in patched.effects:
        reason = f": {destination.reason}" if destination.reason else ""
        if destination.goes_to == CALLBACKS and callbacks_file is None:
            reason = ": give --callbacks FILE.py, MJCF cannot hold it"
        place_text = {CALLBACKS: "in the callbacks" if callbacks_file else "left out", NOWHERE: "left out"}.get(
            destination.goes_to, "in the file"
        )
        lines.append(f"{destination.entry.effect}: {place_text}{reason}")
    return [*lines, *(f"note: {note}" for note in patched.notes)]
