"""Diagnose run files against a model, or against runs of a simulator."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from leactl.errors import InputError
from leactl.gap.diagnose import Progress, diagnose, read_case
from leactl.gap.diagnosis import DiagnosisResult
from leactl.gap.simulated.against import diagnose_against, read_simulated_case
from leactl.runfile.read.reader import Run

MODEL_SOURCE = "model"  # source of a run file that holds its model, as `leactl gap simulate` writes it


def requested_diagnosis(
    runs: Sequence[Path],
    held_out: Sequence[Path],
    model: Path | None,
    simulated: Sequence[Path] = (),
    progress: Progress = lambda _: None,
) -> DiagnosisResult:
    """Diagnose runs against a model, or against the simulator that made other runs on the same inputs.

    Parameters
    ----------
    model : file of the nominal model; with simulated runs, the form and the start of the fit to them. It may be omitted
        if the simulated runs contain their model.

    Raises
    ------
    InputError : files that cannot be used, no model, or simulated runs with other inputs or of another machine.
    """
    if not simulated:
        if model is None:
            raise InputError("no model: name the file of the nominal model, or simulated runs")
        return diagnose(read_case(runs, held_out, model), progress)
    if model is not None:
        return diagnose_against(read_simulated_case(runs, held_out, model, simulated), progress)
    with TemporaryDirectory() as folder:
        model_file = Path(folder) / "model.yaml"
        model_file.write_text(carried_model(simulated), encoding="utf-8")
        return diagnose_against(read_simulated_case(runs, held_out, model_file, simulated), progress)


def carried_model(simulated: Sequence[Path]) -> str:
    """Return the text of the model that all simulated runs contain.

    Raises
    ------
    InputError : files that cannot be used, runs without a model, or with different models; one line each.
    """
    path_by_text: dict[str, Path] = {}
    faults = []
    for path in simulated:
        with Run.open(path) as run:
            text = run.source(MODEL_SOURCE)
        if text is None:
            faults.append(f"{path}: carries no model; give the file of one that its fit begins with (--model)")
        else:
            path_by_text.setdefault(text, path)
    if len(path_by_text) > 1:
        first, second, *_ = path_by_text.values()
        faults.append(f"{second}: carries another model than {first}; give the file of one (--model)")
    if faults:
        raise InputError(faults)
    return next(iter(path_by_text))
