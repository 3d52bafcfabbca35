"""leactl from Python: the functions that the commands call; their answers display themselves in a notebook.

`import leactl` offers all these names, and loads this module when one of them is first used.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.estimate import Result
from leactl.driver.contract import Confirmation
from leactl.errors import AcceptanceFailed, InputError
from leactl.gap.diagnosis import DiagnosisResult
from leactl.gap.replay.replay_run_file import Simulated as Simulated
from leactl.quantities import ChannelSpec
from leactl.runfile.read.reader import Channel as Channel
from leactl.runfile.read.reader import Run as Run

Place = str | Path


class Analysis(Result):
    """Results of one experiment with their 95 % intervals, as `leactl analyze --json` prints them."""

    def __str__(self) -> str:
        from leactl.report.terminal import render

        return render(self)

    def _repr_html_(self) -> str:
        from leactl.report.notebook import analysis_page, framed

        return framed(analysis_page(self))


class Diagnosis(DiagnosisResult):
    """Disagreement of a model and runs, and its causes, as `leactl gap diagnose --json` prints them."""

    def __str__(self) -> str:
        from leactl.report.gap_text import render

        return render(self)

    def _repr_html_(self) -> str:
        from leactl.report.gap_page import page
        from leactl.report.notebook import framed

        return framed(page(self))

    def write(self, *, html: Place | None = None, model: Place | None = None) -> None:
        """Write the page, the calibrated and augmented model, or both; a file that exists already is replaced.

        Raises
        ------
        InputError : a folder does not exist, or a path is that of something other than a regular file.
        """
        from leactl.report.gap_files import Outputs

        outputs = Outputs(None, *(None if path is None else Path(path) for path in (html, model)))
        outputs.check()
        outputs.write(self)


class NotebookChannel(Channel):
    """A channel that displays its curve in a notebook."""

    def _repr_html_(self) -> str:
        from leactl.report.notebook import channel_page, framed

        return framed(channel_page(self))


class NotebookRun(Run):
    """A run file, open for reading, that displays its channels in a notebook."""

    def section(self, stream: str, spec: ChannelSpec, start: int, stop: int) -> NotebookChannel:
        """Return the rows `start` to `stop` (excluded) of a channel.

        Raises
        ------
        InputError : the channel is in `condemned`.
        """
        return NotebookChannel(**vars(super().section(stream, spec, start, stop)))

    def _repr_html_(self) -> str:
        from leactl.report.notebook import framed, run_page

        return framed(run_page(self))


@dataclass(frozen=True)
class Performed:
    """The end of a run, as `leactl run --json` prints it."""

    run: Path
    status: str  # complete, stopped, tripped or failed
    reason: str
    duration_s: float  # bench time
    safe: Mapping[str, Confirmation]  # by device
    acceptance: tuple[Mapping[str, Any], ...]  # each limit of the protocol, and whether it was met
    notes: tuple[str, ...] = ()
    answer: Mapping[str, Any] = field(default_factory=dict, repr=False)  # as `leactl run --json` prints it

    def as_json(self) -> dict[str, Any]:
        """Return the answer as a JSON object."""
        return dict(self.answer)

    def open(self) -> Run:
        """Open the run's file for reading."""
        return NotebookRun.open(self.run)

    def _repr_html_(self) -> str:
        from leactl.report.notebook import ending_page, framed

        ending = ", ".join(filter(None, (self.status, self.reason, f"{self.duration_s:.1f} s of bench time")))
        return framed(ending_page(self.run, ending, self.acceptance, self.safe, self.notes))


def open_run(path: Place) -> Run:
    """Open a run file: `with leactl.open_run("run.h5") as run: run["torque", "test"]`.

    Raises
    ------
    InputError : the file is not a run file, is cut short, or breaks the format; one line for each fault.
    """
    return NotebookRun.open(path)


def analyze(runs: Place | Iterable[Place], experiment: str = "", **options: float) -> Analysis:
    """Fit the parameters that an experiment identifies from its runs; repeated runs are combined.

    Parameters
    ----------
    runs : path of one run file, or of several.
    experiment : name of the analysis; by default the one that the runs name.
    options : values for the analysis, such as `torque_constant=0.48`.

    Raises
    ------
    InputError : files are not runs or are of different experiments, or the analysis does not take an option.
    """
    return Analysis(**vars(analyze_runs(_paths(runs), experiment, **options)))


def diagnose(
    fit: Place | Iterable[Place],
    held_out: Place | Iterable[Place],
    model: Place | None = None,
    progress: Callable[[str], None] = lambda _: None,
    *,
    simulated: Place | Iterable[Place] = (),
) -> Diagnosis:
    """Find where a model and runs disagree, which unmodelled effects cause it, and how far they reduce the gap.

    Parameters
    ----------
    fit : run files from which parameters and effects are identified.
    held_out : run files on which they are judged; if there are none, leactl holds out some runs of `fit`.
    model : file of the nominal model; it may be left out if simulated runs contain one.
    progress : called with a line at the beginning of each step.
    simulated : runs of a simulator on the same inputs; the simulator is then the nominal, and `model` is only where
        the fit starts.

    Raises
    ------
    InputError : files cannot be used, the runs have no channel that the model predicts, or simulated runs are of other
        inputs or of another machine.
    """
    from leactl.gap.simulated.request import requested_diagnosis

    start = None if model is None else Path(model)
    return Diagnosis(**vars(requested_diagnosis(_paths(fit), _paths(held_out), start, _paths(simulated), progress)))


def simulate(model: Place, run: Place, out: Place | None = None) -> Simulated:
    """Simulate a run's inputs with a model, and write the outputs as a run file with the same channels and clocks.

    Parameters
    ----------
    out : path of the new file; by default one in the folder of the run.

    Raises
    ------
    InputError : files cannot be used, the model predicts no channel of this run, or a file exists at `out`.
    """
    from leactl.gap.replay.replay_run_file import simulate as write

    return write(Path(model), Path(run), None if out is None else Path(out))


def run_protocol(
    protocol: Place,
    bench: Place = "emulated",
    settings: Mapping[str, object] | None = None,
    *,
    actuator: str = "",
    condition: str = "",
    operator: str = "",
    out: Place = "runs",
    realtime: bool = False,
    cold: bool = False,
    insert_cooldown: bool = False,
    check: bool = True,
) -> Performed:
    """Run a protocol on an emulated or a real bench; a cell or script that is interrupted leaves the bench safe.

    It must be called in the main thread, which is where an interrupt arrives. `leactl bench stop` ends it too.

    Parameters
    ----------
    protocol, bench : names of shipped files, or paths.
    settings : values of the protocol's parameters by name, also as numbers and arrays of NumPy; `seed` is that of an
        emulated bench.
    out : directory of the run file.
    check : raise the error that ended the run; otherwise the answer contains it.

    Raises
    ------
    InputError : a name, a file or a setting cannot be used, or a protocol for a real bench asks the operator.
    SafetyTrip, Stopped, DeviceError, AcceptanceFailed : with `check`, the run ended so; the error's note has its path.
    """
    from contextlib import nullcontext
    from dataclasses import replace

    from leactl.protocol.plan import Prompt
    from leactl.runner.acceptance import judge_outcome
    from leactl.runner.operators import confirm_at_once
    from leactl.runner.request import prepare
    from leactl.runner.session import execute

    overrides = [f"{name}={_override_text(value)}" for name, value in (settings or {}).items()]
    request = prepare(str(protocol), str(bench), overrides, actuator, condition, operator, Path(out), realtime)
    request = replace(request, cold=cold, insert_cooldown=insert_cooldown)
    asks_operator = any(isinstance(action, Prompt) for action in request.plan.actions)
    if asks_operator and request.bench.emulated is None:
        raise InputError(f"protocol '{request.plan.name}' asks the operator; run it by: leactl run {protocol}")
    outcome = execute(request, confirm_at_once, lambda _progress: nullcontext())
    acceptance, unmet = judge_outcome(request.plan, outcome)
    if check and (outcome.error is not None or unmet):
        error = outcome.error or AcceptanceFailed("; ".join(unmet))
        error.add_note(f"run file: {outcome.path}")
        raise error
    return Performed(
        outcome.path,
        outcome.status,
        outcome.reason,
        outcome.duration_s,
        outcome.safe,
        tuple(acceptance),
        (*outcome.notes, *unmet),
        outcome.as_json() | {"acceptance": acceptance},
    )


def _paths(paths: Place | Iterable[Place]) -> list[Path]:
    """Return one path, or several, as a list."""
    return [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]


def _override_text(value: object) -> str:
    """Return a setting as the text of a command line; numbers and arrays of NumPy become those of Python.

    Raises
    ------
    InputError : the setting is neither a text nor a number or list of numbers.
    """
    try:
        return value if isinstance(value, str) else json.dumps(value, default=lambda array: array.tolist())
    except (AttributeError, TypeError, ValueError):
        raise InputError(f"setting {value!r}: a text, a number or a list of numbers was expected") from None
