"""leactl from Python: the functions that the commands call, with answers that show themselves in a notebook.

`import leactl` offers all of it; nothing here is loaded before it is used.
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
    """Results of one experiment with their 95 % intervals: what `leactl analyze --json` prints."""

    def __str__(self) -> str:
        from leactl.report.terminal import render

        return render(self)

    def _repr_html_(self) -> str:
        from leactl.report.notebook import analysis_page, framed

        return framed(analysis_page(self))


class Diagnosis(DiagnosisResult):
    """Where a model and runs disagree, and why: what `leactl gap diagnose --json` prints."""

    def __str__(self) -> str:
        from leactl.report.gap_text import render

        return render(self)

    def _repr_html_(self) -> str:
        from leactl.report.gap_page import page
        from leactl.report.notebook import framed

        return framed(page(self))

    def write(self, *, html: Place | None = None, model: Place | None = None) -> None:
        """Write the page, and the calibrated, augmented model; an earlier file of the name is replaced.

        Raises
        ------
        InputError : a folder that does not exist, or a name that is no plain file's.
        """
        from leactl.report.gap_files import Outputs

        outputs = Outputs(None, *(None if place is None else Path(place) for place in (html, model)))
        outputs.check()
        outputs.write(self)


class NotebookChannel(Channel):
    """A channel that shows its curve in a notebook."""

    def _repr_html_(self) -> str:
        from leactl.report.notebook import channel_page, framed

        return framed(channel_page(self))


class NotebookRun(Run):
    """A run file, open for reading, that shows its channels in a notebook."""

    def section(self, stream: str, spec: ChannelSpec, start: int, stop: int) -> NotebookChannel:
        """Rows `start` to `stop` (excluded) of a channel.

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
    """How a run ended: what `leactl run --json` prints."""

    run: Path
    status: str  # complete, stopped, tripped or failed
    reason: str
    duration_s: float  # bench time
    safe: Mapping[str, Confirmation]  # by device
    acceptance: tuple[Mapping[str, Any], ...]  # each limit of the protocol, and whether it was met
    notes: tuple[str, ...] = ()
    answer: Mapping[str, Any] = field(default_factory=dict, repr=False)  # as `leactl run --json` prints it

    def as_json(self) -> dict[str, Any]:
        """The answer for other programs."""
        return dict(self.answer)

    def open(self) -> Run:
        """The run's file, open for reading."""
        return NotebookRun.open(self.run)

    def _repr_html_(self) -> str:
        from leactl.report.notebook import ending_page, framed

        ending = ", ".join(filter(None, (self.status, self.reason, f"{self.duration_s:.1f} s of bench time")))
        return framed(ending_page(self.run, ending, self.acceptance, self.safe, self.notes))


def open_run(path: Place) -> Run:
    """Open a run file: `with leactl.open_run("run.h5") as run: run["torque", "test"]`.

    Raises
    ------
    InputError : no run file, cut short, or breaking the format; one line for each fault.
    """
    return NotebookRun.open(path)


def analyze(runs: Place | Iterable[Place], experiment: str = "", **options: float) -> Analysis:
    """Fit the parameters that runs of one experiment were made for; repeats are combined.

    Parameters
    ----------
    runs : one run file or several.
    experiment : what to analyse them as; by default what the runs ask for.
    options : what the analysis may be told, such as `torque_constant=0.48`.

    Raises
    ------
    InputError : files that are no runs or of different experiments, or an option that the analysis does not take.
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
    """Say where a model and runs disagree, which unmodelled effect causes it, and how far the gap shrinks.

    Parameters
    ----------
    fit : run files to learn from.
    held_out : those to judge on; where there are none, runs of `fit` are held out by leactl.
    model : the nominal model's file; it may be left out where simulated runs carry one.
    progress : is told each step as it begins.
    simulated : runs of a simulator on the same inputs: it is the nominal then, and the model only begins its fit.

    Raises
    ------
    InputError : files that cannot be used, runs with nothing that the model could be checked with, or simulated runs of
        other inputs or of another machine.
    """
    from leactl.gap.simulated.request import requested_diagnosis

    start = None if model is None else Path(model)
    return Diagnosis(**vars(requested_diagnosis(_paths(fit), _paths(held_out), start, _paths(simulated), progress)))


def simulate(model: Place, run: Place, out: Place | None = None) -> Simulated:
    """Replay a run's inputs through a model and write what comes out as a run file with the same channels and clocks.

    Parameters
    ----------
    out : the new file; by default one beside the run.

    Raises
    ------
    InputError : files that cannot be used, a model that says nothing of this run, or an existing file at `out`.
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
    protocol, bench : names of shipped ones, or paths.
    settings : parameters of the protocol by name, NumPy's numbers and arrays too; also `seed` of an emulated bench.
    out : directory of the run file.
    check : raise the error that ended the run; else it is told in the answer.

    Raises
    ------
    InputError : a name, a file or a setting that cannot be used, or a protocol that asks a person on a real bench.
    SafetyTrip, Stopped, DeviceError, AcceptanceFailed : what ended the run, with `check`; its notes name the file.
    """
    from contextlib import nullcontext
    from dataclasses import replace

    from leactl.protocol.plan import Prompt
    from leactl.runner.acceptance import judge_all
    from leactl.runner.operators import confirm_at_once
    from leactl.runner.request import prepare
    from leactl.runner.session import execute

    words = [f"{name}={_word(value)}" for name, value in (settings or {}).items()]
    request = prepare(str(protocol), str(bench), words, actuator, condition, operator, Path(out), realtime)
    request = replace(request, cold=cold, insert_cooldown=insert_cooldown)
    asks = any(isinstance(action, Prompt) for action in request.plan.actions)
    if asks and request.bench.emulated is None:
        raise InputError(f"protocol '{request.plan.name}' asks the operator; run it by: leactl run {protocol}")
    outcome = execute(request, confirm_at_once, lambda _progress: nullcontext())
    acceptance, unmet = judge_all(request.plan, outcome)
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


def _paths(given: Place | Iterable[Place]) -> list[Path]:
    return [Path(given)] if isinstance(given, str | Path) else [Path(path) for path in given]


def _word(value: object) -> str:
    """A setting as a command line has it; numbers and arrays of NumPy are those of Python.

    Raises
    ------
    InputError : it is neither a text nor made of numbers.
    """
    try:
        return value if isinstance(value, str) else json.dumps(value, default=lambda other: other.tolist())
    except (AttributeError, TypeError, ValueError):
        raise InputError(f"setting {value!r}: a text, a number or a list of numbers was expected") from None
