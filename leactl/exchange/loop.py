"""Close the loop from a MuJoCo model and runs to a patched model, and compare both in MuJoCo with held-out runs."""

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from leactl.errors import InputError
from leactl.exchange.callbacks import callbacks
from leactl.exchange.export_request import refuse_unusable_outputs, write_all
from leactl.exchange.playing import check_playable, play, rms_of_error
from leactl.exchange.robot_joint import import_joint
from leactl.exchange.robot_patch import Patch, patch, write_patch
from leactl.gap.diagnose import diagnose, read_case
from leactl.gap.diagnosis import DiagnosisResult
from leactl.model.nominal import as_mapping

FORMAT, VERSION = "leactl-gap-loop", 1
Progress = Callable[[str], None]


@dataclass(frozen=True)
class PlayedRun:
    """RMS error of the angle [rad] of one held-out run that was simulated in MuJoCo, for each version of the model."""

    run: str
    before: float  # with the user's file
    file: float  # with the patched file alone
    after: float  # with the patched file and its callbacks


@dataclass(frozen=True)
class ClosedLoop:
    """Diagnosis of a joint, the patched file, and the share of the gap that the patch closes in MuJoCo."""

    joint: str
    answer: DiagnosisResult
    patched: Patch
    runs: tuple[PlayedRun, ...]
    written: tuple[Path, ...]

    @property
    def named(self) -> tuple[str, ...]:
        """Effects of the augmented model in the order of the diagnosis."""
        applied_effects = {entry.effect for entry in self.answer.extra["augmented"].effects}
        return tuple(cause.effect for cause in self.answer.causes if cause.effect in applied_effects)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the diagnosis and on the patch."""
        return (*self.answer.notes, *self.patched.notes)

    @property
    def total(self) -> PlayedRun:
        """RMS of the errors of all runs, each with the same weight."""
        errors = np.array([(run.before, run.file, run.after) for run in self.runs])
        return PlayedRun("all", *np.sqrt(np.mean(errors**2, axis=0)).tolist())

    @property
    def closed(self) -> float:
        """Share of the gap that the patched file with its callbacks closes."""
        total = self.total
        return 1.0 - total.after / total.before if total.before > 0.0 else 0.0

    def as_json(self) -> dict[str, Any]:
        """Return the closed loop as a JSON document."""
        return {
            "format": FORMAT,
            "format_version": VERSION,
            "joint": self.joint,
            "verdict": self.answer.verdict,
            "named": list(self.named),
            "runs": [_figures(run) for run in self.runs],
            "all": _figures(self.total),
            "closed": self.closed,
            "written": [str(path) for path in self.written],
            "effects": self.patched.as_json()["effects"],
            "notes": list(self.notes),
        }


def _figures(run: PlayedRun) -> dict[str, Any]:
    """Return the errors of a run as JSON values."""
    return {"run": run.run, "before_rad": run.before, "file_rad": run.file, "after_rad": run.after}


@dataclass(frozen=True)
class LoopFiles:
    """The files that a loop reads and writes."""

    robot: Path
    runs: Sequence[Path]
    held_out: Sequence[Path]
    out: Path  # the patched robot
    callbacks: Path
    augmented: Path | None = None  # file of the augmented model, if it is wanted


def close_loop(
    files: LoopFiles, joint: str, supply: float | None = None, progress: Progress = lambda _: None
) -> ClosedLoop:
    """Read a joint, diagnose runs with it, patch the robot, and simulate the held-out runs before and after in MuJoCo.

    Parameters
    ----------
    supply : voltage [V] of the joint's position servo.

    Raises
    ------
    InputError : files that cannot be used, a joint that no position servo drives, runs without angle and reference,
        or a patched file from which MuJoCo reads other figures than were written.
    """
    refuse_unusable_outputs((files.out, files.callbacks, files.augmented), files.callbacks)
    imported = import_joint(files.robot, joint, supply)
    if imported.model.drive is None:
        reason = imported.missing.get("drive", "its actuator is no position actuator")
        raise InputError(f"{files.robot}: joint '{joint}' has no position servo: {reason}")
    with TemporaryDirectory() as folder:
        nominal = Path(folder) / f"{files.robot.stem}.yaml"
        nominal.write_text(imported.text, encoding="utf-8")
        case = read_case(files.runs, files.held_out, nominal)
    check_playable([*case.fitted, *case.held_out])
    trial_file = files.out.with_name(f".{files.out.name}.trial.xml")
    try:  # a model that does not fit is refused before the minutes of a diagnosis
        write_patch(patch(imported.model, files.robot, joint, "mjcf"), trial_file)
    finally:
        trial_file.unlink(missing_ok=True)
    progress("playing the runs in MuJoCo")
    errors_before = rms_of_error(case.held_out, play(files.robot, joint, case.held_out))
    answer = diagnose(case, progress)
    model = answer.extra["augmented"]
    patched = patch(model, files.robot, joint, "mjcf")
    model_source = Path("the augmented model") if files.augmented is None else files.augmented
    companion_texts = {files.callbacks: callbacks(model, patched, model_source, files.robot, files.out)}
    if files.augmented is not None:
        companion_texts[files.augmented] = yaml.safe_dump(as_mapping(model), sort_keys=False)
    write_all(patched, files.out, companion_texts)
    progress("playing them again")
    errors_of_file = rms_of_error(case.held_out, play(files.out, joint, case.held_out))
    errors_after = rms_of_error(case.held_out, play(files.out, joint, case.held_out, _install_of(files.callbacks)))
    names = [record.path.name for record in case.held_out]
    runs = tuple(PlayedRun(*row) for row in zip(names, errors_before, errors_of_file, errors_after, strict=True))
    written = tuple(path for path in (files.out, files.callbacks, files.augmented) if path is not None)
    return ClosedLoop(joint, answer, patched, runs, written)


def _install_of(path: Path) -> Callable[[Any], Any]:
    """Return the function `install` of a written file of callbacks."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    install: Callable[[Any], Any] = module.install
    return install
