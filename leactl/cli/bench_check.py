"""`leactl bench check`: check a bench file by itself, against its devices, and against the motion of its shaft."""

import json
from pathlib import Path

import typer

from leactl.cli import TRACE, confirmed, finite, print_answer, traced_to
from leactl.cli.bench_by_hand import AS_JSON, BUS, OUT, REALTIME, SERVED, SETUP
from leactl.cli.completion import complete_bench

BENCH = typer.Argument(help="Name of a shipped bench, or a path to a .yaml.", autocompletion=complete_bench)


def check(
    bench: str = BENCH,
    devices: bool = typer.Option(
        False, "--devices", help="Open every device, drives off: who answers, and what each channel reads."
    ),
    move: bool = typer.Option(
        False, "--move", help="Then turn the shaft a little by one drive after the other: signs, counts, scales."
    ),
    current: float = typer.Option(
        None,
        "--current",
        metavar="AMPERE",
        help="Current of --move; by default twice what friction takes, 3 to 20 % of the continuous current.",
        callback=finite,
    ),
    yes: bool = typer.Option(False, "--yes", help="Do not ask before a real bench is moved."),
    setup: str = SETUP,
    out: Path = OUT,
    realtime: bool = REALTIME,
    served: bool = SERVED,
    bus: list[str] = BUS,
    trace: Path | None = TRACE,
    dry_run: bool = typer.Option(
        False, "--dry-run", help="With --devices or --move: check everything, print the last run's plan, open nothing."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Check a bench file as a run does, without touching a device; or hold it against the bench itself.

    With --devices every drive is off. With --move each drive swings the shaft by a small current, under every check
    and limit of a run; a real bench is asked for before. Each line is a statement of the file with what was
    measured: ok, wrong with the line to change, or cannot tell and why.
    """
    from leactl.errors import InputError

    options_of_move = {"--current": current is not None, "--yes": yes}
    options_of_bench = {"--dry-run": dry_run, "--setup": setup, "--realtime": realtime, "--served": served}
    options_of_bench |= {"--bus": bus, "--trace": trace is not None}
    unusable = [name for name, is_set in options_of_move.items() if is_set and not move]
    unusable += [name for name, is_set in options_of_bench.items() if is_set and not (devices or move)]
    if unusable:
        raise InputError(
            f"{unusable[0]}: goes with {'--move' if unusable[0] in options_of_move else '--devices or --move'} alone"
        )
    if devices or move:
        _examine(bench, move, current, yes, setup, out, realtime, served, bus, trace, dry_run, as_json)
        return
    _check_file(bench, as_json)


def _check_file(bench: str, as_json: bool) -> None:
    """Check a bench file without opening a device, and print its devices, limits and interlocks."""
    from leactl.bench.provenance import overdue
    from leactl.report.terminal import list_line
    from leactl.runner.checked_bench import load_checked

    bench_file, devices, _document = load_checked(bench)
    interlocks = bench_file.interlocks.shown()
    calibration_warnings = overdue(devices)
    if as_json:
        devices_json = [
            {"name": d.name, "driver": d.entry.driver, "role": d.entry.role} | d.entry.facts for d in devices
        ]
        limits = bench_file.limits.model_dump(exclude_none=True)
        body = {"bench": bench_file.name, "devices": devices_json, "limits": limits, "interlocks": interlocks}
        typer.echo(json.dumps(body | {"overdue": calibration_warnings}))
        return
    for name, text in calibration_warnings.items():
        typer.echo(f"leactl: warning: {name}: {text}", err=True)
    typer.echo(list_line("", f"{bench_file.name}: {bench_file.title}".rstrip(": ")))
    for device in devices:
        typer.echo(f"  {device.name:<16} {device.entry.driver:<10} {device.entry.bus or '-':<6} {device.entry.role}")
        for key, fact in device.entry.facts.items():
            typer.echo(f"    {key:<24} {fact}")
    for name, value in bench_file.limits.model_dump(exclude_none=True).items():
        typer.echo(f"  limit {name:<26} {value:g}")
    for name, entries in interlocks.items():
        for entry in entries if isinstance(entries, list | tuple) else [entries]:
            settings = ", ".join(f"{key} {value}" for key, value in entry.items())
            typer.echo(list_line(f"  interlock {name:<22} ", settings))


def _examine(
    bench: str,
    move: bool,
    current: float | None,
    yes: bool,
    setup: str,
    out: Path,
    realtime: bool,
    served: bool,
    bus: list[str],
    trace: Path | None,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Compare a bench file with its bench, and print a verdict on each statement of the file."""
    import sys
    from dataclasses import replace

    from leactl.cli.run import perform, print_dry_run
    from leactl.errors import InputError
    from leactl.report.bench_check import lines
    from leactl.report.terminal import encodable, encoding_of_stdout
    from leactl.runner.bench_check.check import check_bench, request_at_rest, request_turning

    reading_run = request_at_rest(bench, setup, out, realtime, served, bus)
    turning_run = request_turning(bench, current, setup, out, realtime, served, bus) if move else None
    if dry_run:
        typer.echo(f"leactl: {turning_run[1] if turning_run else 'every drive stays off'}", err=True)
        print_dry_run(turning_run[0] if turning_run else reading_run, as_json)
        return
    if turning_run is not None and not (reading_run.in_process or yes or sys.stdin.isatty()):
        raise InputError("a real bench is asked for before it moves, and stdin is no terminal; --yes agrees")
    question = f"{turning_run[1] if turning_run else ''}. Keep clear of the shaft. Go on?"
    with traced_to(trace) as wire_trace:
        reading_run = replace(reading_run, trace=wire_trace)
        if turning_run is not None:
            turning_run = (replace(turning_run[0], trace=wire_trace), turning_run[1])
        examination = check_bench(
            reading_run,
            turning_run,
            perform,
            agrees=lambda: reading_run.in_process or yes or confirmed(question),
        )
    answer = json.dumps(examination.as_json()) if as_json else "\n".join(lines(examination.statements))
    stdout_error = print_answer(encodable(answer, encoding_of_stdout()))
    if turning_run is not None and len(examination.outcomes) < 2:
        typer.echo("leactl: nothing was moved", err=True)
    for note in dict.fromkeys(note for outcome in examination.outcomes for note in outcome.notes):
        typer.echo(f"leactl: {note}", err=True)
    if (error := examination.end()) is not None:
        raise error
    if stdout_error is not None:
        raise stdout_error
