"""`leactl bench stop`, `pause`, `resume`, `remark`, `read`, `zero`, `jog` and `recording`: work at a bench by hand."""

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from leactl.cli import TRACE, finite, print_answer, traced_to
from leactl.cli.completion import complete_bench

if TYPE_CHECKING:
    from collections.abc import Callable

    from leactl.runner.outcome import Outcome
    from leactl.runner.runs_underway import RunUnderway

LONGEST_REMARK = 1000  # characters
READ_S = 2.0  # duration of `bench read`
FOLLOW_INTERVAL_S = 1.0  # between two lines of `bench read --follow`
END_TIMEOUT_S = 20.0  # time for a run to end: a second for each of three devices at most, and its file

BENCH = typer.Argument("emulated", help="Name of a shipped bench, or a path to a .yaml.", autocompletion=complete_bench)
RUNNING = typer.Argument(
    "", help="A bench by name or as a .yaml; without one, every run that this user sees.", autocompletion=complete_bench
)
SETUP = typer.Option("", help="free, locked, coupled or heated; the bench file's own, else coupled.")
OUT = typer.Option(Path("runs/by-hand"), help="Directory of the run file.")
REALTIME = typer.Option(False, "--realtime", help="Keep wall time on an emulated bench.")
SERVED = typer.Option(False, "--served", help="Meet an emulated bench that another process serves.")
BUS = typer.Option([], metavar="NAME=INTERFACE:CHANNEL", help="Put a CAN bus elsewhere.")
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")


def stop(
    bench: str = RUNNING,
    wait_s: float = typer.Option(
        END_TIMEOUT_S, "--wait", metavar="SECONDS", min=0, help="How long to wait for the end.", callback=finite
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Stop the run on a bench and say how it ended."""
    from leactl.errors import DeviceError
    from leactl.runner import runs_underway

    runs, faults = runs_underway.running()
    runs = _runs_on(bench, runs, faults)
    reached_runs = []
    for run in runs:  # every run is asked before the first is waited for
        try:
            run.ask_to_stop()
            reached_runs.append(run)
        except DeviceError as fault:
            faults.append(str(fault))
    deadline = time.monotonic() + wait_s
    endings = [_ending_json(run, run.wait(deadline), wait_s) for run in reached_runs]
    faults += [f"{ending_json['bench']}: {ending_json['doubt']}" for ending_json in endings if ending_json["doubt"]]
    lines = [] if runs else [f"nothing runs on {bench}" if bench else "nothing runs"]
    for ending_json in endings:
        if not ending_json["doubt"]:
            ending_text = (
                f"{ending_json['status']}: {ending_json['reason']}; {ending_json['run']}"
                if ending_json["ended"]
                else "its file is still written"
            )
            lines.append(f"{ending_json['bench']}: every device confirmed safe; {ending_text}")
    stdout_error = None
    if as_json or lines:
        stdout_error = print_answer(json.dumps({"runs": endings}) if as_json else "\n".join(lines))
    if faults:
        raise DeviceError("; ".join(faults))
    if stdout_error is not None:
        raise stdout_error


def pause(bench: str = RUNNING, as_json: bool = AS_JSON) -> None:
    """Let the run on a bench pause at its next rest, where nothing is commanded, until `bench resume` or its key p."""
    _ask_each(bench, as_json, lambda run: run.ask_to_pause(True), "pauses at its next rest")


def resume(bench: str = RUNNING, as_json: bool = AS_JSON) -> None:
    """Let the run on a bench that pauses go on."""
    _ask_each(bench, as_json, lambda run: run.ask_to_pause(False), "goes on")


def remark(
    text: str = typer.Argument(help="Text for the record."), bench: str = RUNNING, as_json: bool = AS_JSON
) -> None:
    """Record a remark in the events of the run on a bench, with the moment at which the run sees it."""
    from leactl.errors import InputError

    if not text.strip() or len(text) > LONGEST_REMARK:
        raise InputError(f"a remark of {len(text)} characters; from 1 to {LONGEST_REMARK} were expected")
    _ask_each(bench, as_json, lambda run: run.remark(text), "records it")


def _ask_each(bench: str, as_json: bool, ask: "Callable[[RunUnderway], None]", confirmation: str) -> None:
    """Call `ask` with every run on a bench, and print the runs that were reached, each followed by `confirmation`.

    Raises
    ------
    DeviceError : no run is active there, or a run cannot be reached.
    """
    from leactl.errors import DeviceError
    from leactl.runner import runs_underway

    runs, faults = runs_underway.running()
    runs = _runs_on(bench, runs, faults)
    reached_runs = []
    for run in runs:
        try:
            ask(run)
            reached_runs.append(run)
        except DeviceError as fault:
            faults.append(str(fault))
        finally:
            run.close()
    runs_json = [{"bench": run.bench, "protocol": run.protocol, "process": run.process} for run in reached_runs]
    typer.echo(
        json.dumps({"runs": runs_json}) if as_json else "\n".join(f"{run} {confirmation}" for run in reached_runs),
        nl=bool(reached_runs),
    )
    if not runs:
        faults.append(f"nothing runs on {bench}" if bench else "nothing runs")
    if faults:
        raise DeviceError("; ".join(faults))


def _runs_on(bench: str, runs: "list[RunUnderway]", faults: list[str]) -> "list[RunUnderway]":
    """Return the runs on a bench, which is given by name or by the path of its file; without a bench, all runs.

    A bench that a process has locked without a file that describes its run is added to `faults`.
    """
    from leactl.runner.runs_underway import unseen

    if not bench:
        return runs
    path = str(Path(bench).resolve())
    matching_runs = [run for run in runs if bench == run.bench or path == run.file]
    if matching_runs:
        return matching_runs
    from leactl.bench.benchfile import load

    lock_fault = unseen(bench)
    name = bench if lock_fault else load(bench)[0].name
    matching_runs = [run for run in runs if run.bench == name]
    lock_fault = lock_fault or ("" if matching_runs else unseen(name))
    if lock_fault:
        faults.append(lock_fault)
    return matching_runs


def _ending_json(run: "RunUnderway", has_ended: bool, waited_s: float) -> dict[str, Any]:
    """Return how a run ended, and why its safe state is in doubt, as a JSON object."""
    run_facts = run.facts()
    safe = run_facts.get("safe", {})
    unsafe_details = [f"{name}: {device['detail']}" for name, device in safe.items() if not device["confirmed"]]
    doubt = ""
    if unsafe_details:
        doubt = "; ".join(unsafe_details)
    elif not safe and has_ended:
        doubt = run_facts.get("reason") or f"process {run.process} died without a word"
    elif not safe:
        doubt = f"process {run.process} has not answered within {waited_s:g} s"
    return {
        "bench": run.bench,
        "protocol": run.protocol,
        "process": run.process,
        "ended": has_ended,
        "status": run_facts.get("status", ""),
        "reason": run_facts.get("reason", ""),
        "run": run_facts.get("run", ""),
        "safe": safe,
        "doubt": f"NOT CONFIRMED SAFE, switch off the supply: {doubt}" if doubt else "",
    }


def read(
    bench: str = BENCH,
    hold_s: float = typer.Option(
        None, "--for", metavar="SECONDS", help="How long to read; 2 s, with --follow until Ctrl-C.", callback=finite
    ),
    follow: bool = typer.Option(
        False, "--follow", help="Print a line of the newest readings each second, by wall time, until Ctrl-C."
    ),
    every: float = typer.Option(
        None,
        "--every",
        metavar="SECONDS",
        min=0.02,
        help="With --follow: time between two lines; by default 1 s.",
        callback=finite,
    ),
    channels: list[str] = typer.Option(
        [], "--channel", metavar="NAME", help="With --follow: this channel alone, as in `runs plot`; may be repeated."
    ),
    setup: str = SETUP,
    out: Path = OUT,
    realtime: bool = REALTIME,
    served: bool = SERVED,
    bus: list[str] = BUS,
    trace: Path | None = TRACE,
    as_json: bool = AS_JSON,
) -> None:
    """Read every channel with all drives off: mean, standard deviation and age; --follow prints readings as they come.

    A line has nan (JSON: null) where a stream has no new row since the line before, or no number in its newest one. A
    device that stays silent is named once on stderr and the lines go on, unless its driver or an interlock ends the
    run, as in any run. The run file holds about one row of a stream for each line.
    """
    from dataclasses import asdict

    from leactl.cli.run import finish
    from leactl.errors import InputError
    from leactl.protocol.by_hand import reading_steps
    from leactl.report.readings import readings, table
    from leactl.runfile.read.reader import Run

    if follow:
        _follow(bench, hold_s, every or FOLLOW_INTERVAL_S, channels, setup, out, realtime, served, bus, trace, as_json)
        return
    if every is not None or channels:
        raise InputError(f"{'--channel' if channels else '--every'}: goes with --follow alone")
    steps = reading_steps(READ_S if hold_s is None else hold_s)
    outcome = _perform("read", steps, bench, setup, out, realtime, served, bus, trace, everything=True)
    summaries = []
    if outcome.error is None:
        with Run.open(outcome.path) as run:
            summaries = readings(run)
    stdout_error = None
    if as_json or summaries:
        body = outcome.as_json() | {"channels": [asdict(summary) for summary in summaries]}
        stdout_error = print_answer(json.dumps(body) if as_json else table(summaries))
    finish(outcome, [], stdout_error)


def _follow(
    bench: str,
    hold_s: float | None,
    every_s: float,
    channels: list[str],
    setup: str,
    out: Path,
    realtime: bool,
    served: bool,
    bus: list[str],
    trace: Path | None,
    as_json: bool,
) -> None:
    """Read a bench and print a line of readings every `every_s` seconds, for `hold_s` or until a person stops it."""
    from dataclasses import replace

    from leactl.cli.run import ending_line, finish, warn_overdue
    from leactl.errors import Stopped
    from leactl.protocol.by_hand import endless_steps, reading_steps
    from leactl.report.follow import Follower, ReadingSampler
    from leactl.runner.dry_run import streams_of
    from leactl.runner.operators import keyboard
    from leactl.runner.request import prepare_by_hand
    from leactl.runner.session import execute
    from leactl.runner.stop_requests import signals_kept_to_the_end

    steps = endless_steps() if hold_s is None else reading_steps(hold_s)
    request = prepare_by_hand("read", steps, bench, setup, out, realtime, served, bus, everything=True)
    request = replace(request, realtime=realtime or request.in_process, record_every_s=every_s)
    follower = Follower(ReadingSampler(request.bench.name, streams_of(request), channels), every_s, as_json)
    warn_overdue(request)
    with signals_kept_to_the_end():
        with traced_to(trace) as wire_trace, keyboard(shown=sys.stderr.isatty()) as keys:
            request = replace(request, trace=wire_trace)
            outcome = execute(request, _never_confirmed, follower.watch, [keys.pressed, follower.stop_cause])
        stdout_error = follower.stdout_error
        if as_json and stdout_error is None:
            stdout_error = print_answer(json.dumps({"event": "end", **outcome.as_json()}))
        if not as_json:
            typer.echo(ending_line(outcome), err=True)
    if follower.stdout_error is not None and isinstance(outcome.error, Stopped):
        outcome = replace(outcome, error=None)  # stdout_error, which stopped the run, is raised instead
    new_notes = [note for note in outcome.notes if note not in follower.printed_warnings]
    finish(replace(outcome, notes=new_notes), [], stdout_error)


def _never_confirmed(_question: str) -> "Callable[[], bool]":
    """Return a function that never confirms: the prompt of an endless reading stays open, so that it goes on."""
    return lambda: False


def zero(
    bench: str = BENCH,
    setup: str = SETUP,
    out: Path = OUT,
    realtime: bool = REALTIME,
    served: bool = SERVED,
    bus: list[str] = BUS,
    trace: Path | None = TRACE,
    as_json: bool = AS_JSON,
) -> None:
    """Take the zero of the torque sensor as a protocol does, and say how far it is from the bench file's."""
    from leactl.cli.run import finish
    from leactl.protocol.by_hand import tare_steps

    outcome = _perform("zero", tare_steps(), bench, setup, out, realtime, served, bus, trace)
    zeros = {name: {"before_Nm": before, "after_Nm": after} for name, (before, after) in outcome.zeros.items()}
    lines = [
        f"{name}: offset {after:.6g} N*m, before {before:.6g} N*m, moved by {after - before:+.3g} N*m"
        for name, (before, after) in outcome.zeros.items()
    ]
    stdout_error = None
    if as_json or lines:
        stdout_error = print_answer(json.dumps(outcome.as_json() | {"zeros": zeros}) if as_json else "\n".join(lines))
    finish(outcome, [], stdout_error)


def jog(
    bench: str = BENCH,
    role: str = typer.Option("test", help="test or load."),
    current: float = typer.Option(None, metavar="AMPERE", help="Hold this q-axis current.", callback=finite),
    velocity: float = typer.Option(None, metavar="RAD/S", help="Turn at this velocity.", callback=finite),
    angle: float = typer.Option(
        None, metavar="RAD", help="Turn by this angle from where the shaft stands.", callback=finite
    ),
    hold_s: float = typer.Option(
        1.0, "--for", metavar="SECONDS", help="How long to hold the setpoint.", callback=finite
    ),
    rate: float = typer.Option(
        None, help="A/s, rad/s^2 or rad/s on the way; 5, 10 or 0.5 unless given.", callback=finite
    ),
    setup: str = SETUP,
    out: Path = OUT,
    realtime: bool = REALTIME,
    served: bool = SERVED,
    bus: list[str] = BUS,
    trace: Path | None = TRACE,
    dry_run: bool = typer.Option(
        False, "--dry-run", help="Check everything, print the plan, and move nothing; an angle begins at 0 rad."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Move one drive for a moment, under every check and limit of a run."""
    from dataclasses import replace

    from leactl.cli.run import ending_line, finish, perform, print_dry_run
    from leactl.driver.contract import Mode
    from leactl.errors import InputError
    from leactl.protocol.by_hand import Jog, reading_steps
    from leactl.runfile.read.reader import Run
    from leactl.runner.request import prepare_by_hand

    value_by_mode = {Mode.CURRENT: current, Mode.VELOCITY: velocity, Mode.ANGLE: angle}
    setpoints = [(mode, value) for mode, value in value_by_mode.items() if value is not None]
    if len(setpoints) != 1:
        raise InputError(f"one of --current, --velocity, --angle was expected, {len(setpoints)} were given")
    motion = Jog(role, *setpoints[0], hold_s, rate)
    motion.check()
    if dry_run:
        if motion.mode is Mode.ANGLE:
            note = "the shaft is taken to stand at 0 rad; a jog reads where it stands, and checks the angle from there"
            typer.echo(f"leactl: {note}", err=True)
        request = prepare_by_hand("jog", motion.steps(), bench, setup, out, realtime, served, bus)
        print_dry_run(request, as_json)
        return
    # angles of a protocol are absolute, so that they can be checked before a drive moves
    name, steps = ("read", reading_steps(0.2)) if motion.mode is Mode.ANGLE else ("jog", motion.steps())
    request = prepare_by_hand(name, steps, bench, setup, out, realtime, served, bus)
    with traced_to(trace) as wire_trace:
        if motion.mode is Mode.ANGLE:
            reading = perform(replace(request, trace=wire_trace))
            finish(reading, [], None)
            with Run.open(reading.path) as run:
                present_angle = float(run.channel("angle", role).values[-1])
            request = prepare_by_hand("jog", motion.steps(present_angle), bench, setup, out, realtime, served, bus)
        outcome = perform(replace(request, trace=wire_trace))
    finish(outcome, [], print_answer(json.dumps(outcome.as_json()) if as_json else ending_line(outcome)))


def recording(
    device: str = typer.Argument(help="Name of the device in the bench file."),
    bench: str = BENCH,
    out: Path = typer.Option(..., "--out", help="New file for the recording."),
    bus: list[str] = BUS,
    trace: Path | None = TRACE,
    as_json: bool = AS_JSON,
) -> None:
    """Save what a drive's own recorder holds as a text table, for `leactl runs attach`; the drive is off meanwhile."""
    from leactl.bench.wire_trace import files_of_trace
    from leactl.report.outputs import check_files
    from leactl.runner.own_recording import save_recording

    check_files([out, *(files_of_trace(trace) if trace else [])], [])
    with traced_to(trace) as wire_trace:
        saved = save_recording(bench, device, out, bus, wire_trace)
    if as_json:
        answer = {"file": str(saved.file), "columns": saved.headings, "rows": saved.rows, "interval_s": saved.interval}
        typer.echo(json.dumps(answer))
    else:
        typer.echo(f"{saved.file}: {saved.rows} rows every {saved.interval:g} s: {', '.join(saved.headings)}")


def _perform(
    name: str,
    steps: list[str],
    bench: str,
    setup: str,
    out: Path,
    realtime: bool,
    served: bool,
    bus: list[str],
    trace: Path | None,
    everything: bool = False,
) -> "Outcome":
    """Run steps that are no protocol on a bench; with `everything`, all devices of the bench take part."""
    from dataclasses import replace

    from leactl.cli.run import perform
    from leactl.runner.request import prepare_by_hand

    request = prepare_by_hand(name, steps, bench, setup, out, realtime, served, bus, everything)
    with traced_to(trace) as wire_trace:
        return perform(replace(request, trace=wire_trace))
