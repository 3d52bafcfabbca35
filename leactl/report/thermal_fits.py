"""Fits of the thermal network of each actuator to its runs; runs without the channels for a fit are left out."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from leactl.analysis.analyze import refuse_altered, refuse_repeated, remarks_on
from leactl.analysis.quality.channel_plausibility import channel_doubts
from leactl.errors import InputError
from leactl.gap.thermal_fit import ThermalFit, missing_channels, thermal_fit
from leactl.model.motor import Motor
from leactl.runfile.catalog.summaries import run_files
from leactl.runfile.read.reader import Run


@dataclass(frozen=True)
class ActuatorFit:
    """The thermal network of one actuator, fitted to its runs."""

    actuator: str
    runs: tuple[str, ...]
    fit: ThermalFit
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return parameters, their correlation, the resulting tolerances and notes as JSON takes them."""
        return {
            "actuator": self.actuator,
            "runs": list(self.runs),
            "parameters": [asdict(parameter) for parameter in self.fit.parameters],
            "correlation": [[round(float(value), 4) for value in row] for row in self.fit.correlation],
            "tolerances": self.fit.tolerances,
            "notes": list(self.notes),
        }


def thermal_fits(paths: Sequence[Path], motor: Motor) -> tuple[list[ActuatorFit], list[str]]:
    """Fit the network of each actuator to its runs.

    Returns
    -------
    A fit for each actuator, and a line for each file that was left out: a run without the channels that a fit needs,
    or a file in a named folder that is no run.

    Raises
    ------
    InputError : a named file that cannot be read, a run that is given twice or was altered after it was closed, no run
        with the channels that a network needs, or one of these channels that fails the gate of the analyses.
    """
    in_folders = {file for path in paths if path.is_dir() for file in run_files([path])}
    left_out: list[str] = []
    faults: list[str] = []
    usable_runs: list[Run] = []
    with ExitStack() as open_runs:
        for path in run_files(paths):
            try:
                run = open_runs.enter_context(Run.open(path))
            except InputError as error:
                (left_out if path in in_folders else faults).extend(error.faults)
                continue
            if channels_missing := missing_channels(run):
                left_out.append(f"{path}: has no {', no '.join(channels_missing)}; a thermal network needs it")
            else:
                usable_runs.append(run)
        if faults or not usable_runs:
            raise InputError(faults or left_out)
        refuse_repeated(usable_runs)
        refuse_altered(usable_runs)
        runs_by_actuator: dict[str, list[Run]] = {}
        for run in usable_runs:
            runs_by_actuator.setdefault(str(run.attributes.get("actuator", "")), []).append(run)
        return [actuator_fit(actuator, runs, motor) for actuator, runs in runs_by_actuator.items()], left_out


def actuator_fit(actuator: str, runs: Sequence[Run], motor: Motor) -> ActuatorFit:
    """Fit the thermal network of one actuator to its runs; notes on doubtful channels come before those of the fit."""
    notes = [note for run in runs for note in (*channel_doubts(run), *remarks_on(run))]
    fit = thermal_fit(runs, motor)
    return ActuatorFit(actuator, tuple(str(run.path) for run in runs), fit, tuple(dict.fromkeys([*notes, *fit.notes])))
