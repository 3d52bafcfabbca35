"""`leactl run`: execute a protocol on a bench and record the run."""

import json
import re
import sys
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand

from leactl.cli import TRACE, print_answer, traced_to
from leactl.cli.completion import complete_bench, complete_protocol, complete_setting
from leactl.cli.helptext import ON_A_BENCH, examples, single_command
from leactl.errors import AcceptanceFailed
from leactl.report.web import FREE_PORT_HERE

app = single_command()

if TYPE_CHECKING:
    from leactl.report.web.feed import RunPage
    from leactl.runner.outcome import Outcome
    from leactl.runner.request import Request

ATTENDED = typer.Option(
    False, "--attended", help="Somebody stays by the bench, to switch off a supply if this machine fails."
)

WEB = "--web"
ADDRESS_LIKE = re.compile("localhost|[0-9.]+|[^-].*:.*|:.*")  # also faulty addresses, which RunPage refuses


class RunWithPage(TyperCommand):
    """A command whose option `--web` may have an address or none."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the default address after a `--web` without one, and parse."""
        return super().parse_args(ctx, self.completed(args))

    def completed(self, args: list[str]) -> list[str]:
        """Return the words with the default address after each `--web` that no address follows.

        A word with a colon or of digits is an address; the name of a protocol is neither.
        """
        words: list[str] = []
        for word, following in pairwise([*args, ""]):
            words.append(word)
            if word == WEB and not ADDRESS_LIKE.fullmatch(following):
                words.append(FREE_PORT_HERE)
        return words


@app.command(
    cls=RunWithPage,
    epilog=examples(
        "run friction --bench emulated --out runs",
        "run torque-constant --bench mine.yaml --set hold_s=6 --actuator LEA-2",
        "run friction --bench mine.yaml --dry-run",
        "run friction --bench mine.yaml --web",
        ends=(*ON_A_BENCH, AcceptanceFailed),
    ),
)
def run(
    protocol: str = typer.Argument(
        help="Name of a shipped protocol, or a path to a .yaml.", autocompletion=complete_protocol
    ),
    bench: str = typer.Option(
        "emulated", help="Name of a shipped bench, or a path to a .yaml.", autocompletion=complete_bench
    ),
    settings: list[str] = typer.Option(
        [], "--set", metavar="NAME=VALUE", help="Set a parameter; seed=N on emulated.", autocompletion=complete_setting
    ),
    actuator: str = typer.Option("", help="Which actuator is on the bench: its serial number or any label."),
    condition: str = typer.Option("", help="Condition of the run: unloaded, design, loaded or any label."),
    operator: str = typer.Option("", help="Who runs the bench."),
    out: Path = typer.Option(Path("runs"), help="Directory of the run file."),
    realtime: bool = typer.Option(False, "--realtime", help="Keep wall time on an emulated bench."),
    served: bool = typer.Option(False, "--served", help="Meet an emulated bench that another process serves."),
    bus: list[str] = typer.Option(
        [],
        metavar="NAME=INTERFACE:CHANNEL",
        help="Put a bus elsewhere; NAME=serial:PORT a serial line, NAME=visa:RESOURCE a raw socket.",
    ),
    cold: bool = typer.Option(False, "--cold", help="Nothing has heated the actuators since they were at ambient."),
    insert_cooldown: bool = typer.Option(False, "--insert-cooldown", help="Wait where a winding would grow too hot."),
    attended: bool = ATTENDED,
    events: Path | None = typer.Option(
        None, "--events", metavar="FILE", help="Tell the run as it goes, one JSON line at a time; - is stdout."
    ),
    web: str | None = typer.Option(
        None,
        WEB,
        metavar="[ADDRESS:PORT]",
        help="Show the run in a browser, on this machine unless an address follows.",
    ),
    at_end: str | None = typer.Option(
        None, "--at-end", metavar="COMMAND", help="Run this when the run is over: COMMAND STATUS RUN.h5."
    ),
    trace: Path | None = TRACE,
    dry_run: bool = typer.Option(False, "--dry-run", help="Check everything, print the plan, and move nothing."),
    as_json: bool = typer.Option(False, "--json", help="Print JSON on stdout."),
) -> None:
    """Run a protocol on a bench: every setpoint supervised, every sample in one run file."""
    from leactl.errors import InputError
    from leactl.report.outputs import check_folder
    from leactl.runner.acceptance import judge_outcome
    from leactl.runner.event_lines import STDOUT, EventLines
    from leactl.runner.outcome import status_of
    from leactl.runner.request import prepare
    from leactl.runner.stop_requests import signals_kept_to_the_end

    request = prepare(protocol, bench, settings, actuator, condition, operator, out, realtime, served, bus)
    plan = replace(request.plan, attended=attended or request.plan.attended)
    request = replace(request, plan=plan, cold=cold, insert_cooldown=insert_cooldown)
    at_end_words = [] if at_end is None else _at_end_words(at_end)
    if as_json and events == STDOUT:
        raise InputError("--events -: stdout is for --json alone; name a file")
    page: AbstractContextManager[RunPage | None] = nullcontext()
    if web is not None:
        from leactl.report.web import feed

        page = feed.RunPage(web, request.bench.name)
    if dry_run:
        print_dry_run(request, as_json)
        return
    check_folder(request.directory)
    with (
        signals_kept_to_the_end(),
        page as open_page,
        EventLines(events) if events else nullcontext() as event_lines,
        traced_to(trace) as wire_trace,
    ):
        try:
            outcome = perform(replace(request, lines=event_lines, trace=wire_trace), page=open_page)
        except BaseException as error:
            # there is no run file: a device could not be opened, or the run was refused
            status, reason = status_of(error)
            if event_lines is not None:
                event_lines.end(run=None, status=status, reason=reason)
            if warning := _run_at_end(at_end_words, status, ""):
                error.add_note(f"warning: {warning}")
            raise
        acceptance, unmet = judge_outcome(request.plan, outcome)
        answer = outcome.as_json() | {"acceptance": acceptance}
        if event_lines is not None:
            event_lines.end(**answer)
        stdout_error = None
        if as_json or events != STDOUT:
            stdout_error = print_answer(json.dumps(answer) if as_json else ending_line(outcome))
        # inside the block: after it signals are ignored, also by a process that is started
        warning = _run_at_end(at_end_words, outcome.status, str(outcome.path))
    faults = [
        output.fault for output in (event_lines, open_page) if output is not None and output.fault not in outcome.notes
    ]
    for note in filter(None, (warning, *faults)):
        print(f"leactl: warning: {note}", file=sys.stderr)
    finish(outcome, unmet, stdout_error)


def _at_end_words(command: str) -> list[str]:
    """Split the command of `--at-end` into words.

    Raises
    ------
    InputError : the command is empty, a quote is not closed, or there is no such program.
    """
    import shlex
    import shutil

    from leactl.errors import InputError

    try:
        words = shlex.split(command)
    except ValueError as error:
        raise InputError(f"--at-end {command}: {error}") from None
    if not words:
        raise InputError("--at-end: the command is empty; leave the option out where nothing is to be run")
    if shutil.which(words[0]) is None:
        raise InputError(f"--at-end {command}: there is no program '{words[0]}'")
    return words


def _run_at_end(words: list[str], status: str, run_path: str) -> str:
    """Run the command of `--at-end` with status and file of the run; return its failure as text, or an empty text."""
    import subprocess

    if not words:
        return ""
    try:
        # its output goes to stderr: stdout is for --json and --events
        process = subprocess.run([*words, status, run_path], stdout=sys.stderr.fileno(), check=False)
    except OSError as error:
        return f"--at-end {words[0]}: {error.strerror}"
    return f"--at-end {words[0]}: ended with status {process.returncode}" if process.returncode else ""


def print_dry_run(request: "Request", as_json: bool) -> None:
    """Check a request as a run does, and print what the run would do; no device is opened.

    Raises
    ------
    InputError, SafetyTrip, DeviceError : a check fails, as it would before a run opens a device.
    """
    from leactl.report.outputs import check_folder
    from leactl.report.plan import dry_run_body, dry_run_text
    from leactl.runner.dry_run import dry_run

    check_operator(request)
    check_folder(request.directory)
    dry_run_result = dry_run(request)
    body = dry_run_body(request, dry_run_result)
    for text in dry_run_result.warnings:
        print(f"leactl: warning: {text}", file=sys.stderr)
    typer.echo(json.dumps(body) if as_json else dry_run_text(request, dry_run_result, body))


def perform(request: "Request", heading: str = "", page: "RunPage | None" = None) -> "Outcome":
    """Execute a run with the live view on stderr and, if there is a page, in the browser.

    Parameters
    ----------
    heading : text before the title of the view.
    """
    from rich.console import Console

    from leactl.report.run_progress import live_view
    from leactl.runner.operators import confirm_at_once, keyboard
    from leactl.runner.progress import Progress
    from leactl.runner.session import execute

    console = Console(file=sys.__stderr__)
    is_emulated = request.bench.emulated is not None
    check_operator(request)
    warn_overdue(request)
    if page is not None:
        print(f"leactl: the run's page: {page.url}", file=sys.stderr)
        if not page.is_of_this_machine_alone:
            warning = "the page is not encrypted: who can read this network's traffic can see the run and stop it"
            print(f"leactl: warning: {warning}", file=sys.stderr)
    with keyboard(shown=console.is_terminal) as keys:

        def watch(progress: Progress) -> AbstractContextManager[object]:
            progress.hint = keys.hint or f"leactl bench stop {request.bench.name} stops the run"
            progress.title = f"{heading}{progress.title}"
            if page is not None:
                page.show(progress)
            return live_view(progress, console)

        stop_checks = [keys.pressed] if page is None else [keys.pressed, page.stop_cause]
        outcome = execute(
            request, confirm_at_once if is_emulated else keys.ask, watch, stop_checks, [keys.pause_pressed]
        )
    if page is not None:
        page.end(outcome.status, outcome.reason, str(outcome.path))
    return outcome


def warn_overdue(request: "Request") -> None:
    """Warn on stderr of devices of a run whose calibration is overdue."""
    from leactl.bench.provenance import overdue

    for name, text in overdue(request.devices).items():
        print(f"leactl: warning: {name}: {text}", file=sys.stderr)


def check_operator(request: "Request") -> None:
    """Raise if no operator can answer the prompts of a plan; an emulated bench needs no operator.

    Raises
    ------
    InputError : the plan has prompts, and stdin is no terminal.
    """
    from leactl.errors import InputError
    from leactl.protocol.plan import Prompt

    has_prompts = any(isinstance(action, Prompt) for action in request.plan.actions)
    if has_prompts and request.bench.emulated is None and not sys.stdin.isatty():
        raise InputError(f"protocol '{request.plan.name}' asks the operator, and stdin is no terminal")


def ending_line(outcome: "Outcome") -> str:
    """Return the file, the status and the duration of a run in one line."""
    return f"{outcome.path}  {outcome.status}, {outcome.duration_s:.1f} s of bench time"


def finish(outcome: "Outcome", unmet: list[str], stdout_error: OSError | None) -> None:
    """Print the notes of a run on stderr, and raise the error that the command has to end with, if there is one.

    Raises
    ------
    LeactlError : the error that ended the run; or AcceptanceFailed for the limits in `unmet`.
    OSError : `stdout_error`, if the run itself ended well.
    """
    from leactl.errors import AcceptanceFailed

    for note in outcome.notes:
        print(f"leactl: {note}", file=sys.stderr)
    if outcome.error is not None:
        raise outcome.error
    if unmet:
        raise AcceptanceFailed("; ".join(unmet))
    if stdout_error is not None:
        raise stdout_error
