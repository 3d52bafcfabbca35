"""`leactl safety`: rehearse faults on a bench, and search for courses that beat the thermal guard."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from leactl.cli import confirmed, finite
from leactl.cli.completion import complete_bench
from leactl.cli.helptext import ON_A_BENCH, examples, group_of_commands
from leactl.errors import SafetyTrip

if TYPE_CHECKING:
    from leactl.runner.drill.finding import Drilled, PlannedDrill
    from leactl.runner.drill.real import RealDrill

app = group_of_commands()
REPORT_HEADING = """# The drill of the bench `{bench}`

Written by `{command}`; `leactl docs safety` says what the columns mean, `leactl docs faults` what the faults are.

"""


@app.callback()
def safety() -> None:
    """Rehearse what keeps a bench safe."""


@app.command(
    epilog=examples(
        "safety drill",
        "safety drill mine.yaml --only frozen_drive",
        "safety drill mine.yaml --dry-run",
        ends=ON_A_BENCH,
        means={SafetyTrip: "safety trip or a rehearsal that did not end as it ought to"},
    )
)
def drill(
    bench: str = typer.Argument(
        "emulated", help="Name of a shipped bench, or a path to a .yaml.", autocompletion=complete_bench
    ),
    only: list[str] = typer.Option([], metavar="NAME", help="This rehearsal alone; `leactl bench faults` lists them."),
    yes: bool = typer.Option(False, "--yes", help="Do not ask before each rehearsal on a real bench."),
    served: bool = typer.Option(False, "--served", help="Meet an emulated bench that another process serves."),
    bus: list[str] = typer.Option([], metavar="NAME=INTERFACE:CHANNEL", help="Put a bus elsewhere."),
    out: Path = typer.Option(None, help="Keep the run files here, each beside its bench file."),
    report: Path = typer.Option(None, metavar="FILE", help="Write the report to this .md as well."),
    dry_run: bool = typer.Option(False, "--dry-run", help="Check everything, say what would move, and move nothing."),
    as_json: bool = typer.Option(False, "--json", help="Print JSON on stdout."),
) -> None:
    """Rehearse every fault on a bench: what caught it, how fast, how the bench ended.

    On a real bench nothing is put out of order: stops, and a sensor that you unplug, each asked for before.
    """
    import tempfile
    from dataclasses import replace

    from leactl.report.drill import markdown, planned_body, planned_text, print_drill

    if dry_run:
        body = planned_body(_planned_drill(bench, only, served, bus, out or Path()))
        typer.echo(json.dumps(body) if as_json else planned_text(body))
        return
    if report is not None:
        _write_report(report, "", "a")  # refuse a report that cannot be written before the first rehearsal
    if out is not None:
        _make_folder(out)
        drilled = _drill(bench, only, yes, served, bus, out)
    else:
        with tempfile.TemporaryDirectory(prefix="leactl-drill-") as folder:
            drilled = _drill(bench, only, yes, served, bus, Path(folder))
        drilled = replace(drilled, findings=[replace(finding, run="") for finding in drilled.findings])
    if report is not None:
        heading = REPORT_HEADING.format(bench=drilled.bench, command=_report_command(bench, only, report))
        _write_report(report, heading + markdown(drilled))
    if as_json:
        typer.echo(json.dumps(drilled.as_json()))
    else:
        print_drill(drilled)
    failures = [finding for finding in drilled.findings if not finding.held]
    if failures:
        failure_texts = "; ".join(
            f"{finding.name} {finding.on}".strip() + f": {finding.faults[0]}" for finding in failures
        )
        raise SafetyTrip(f"{len(failures)} of {len(drilled.findings)} did not end as they ought to: {failure_texts}")


@app.command(
    epilog=examples(
        "safety challenge --minutes 10",
        "safety challenge mine.yaml --rate 1000 --optimiser cma --json",
        ends=(SafetyTrip,),
        means={SafetyTrip: "a bound below the truth or a winding above its limit"},
    )
)
def challenge(
    bench: str = typer.Argument(
        "emulated", help="Name of a shipped bench, or a path to a .yaml.", autocompletion=complete_bench
    ),
    minutes: float = typer.Option(1.0, help="Time for all searches together.", callback=finite),
    rate: list[float] = typer.Option(
        [], metavar="HZ", help="Rate of the control loop; may be repeated. [20 100 500 1000]", callback=finite
    ),
    seed: int = typer.Option(0, min=0, help="Seed of the first draws; how far a search comes depends on the machine."),
    optimiser: str = typer.Option("changes", help="How the next course is chosen: changes, or cma from leactl[cma]."),
    as_json: bool = typer.Option(False, "--json", help="Print JSON on stdout."),
) -> None:
    """Search for currents and motions that heat a winding beyond what the guard says; nothing moves.

    Plants of three phases inside the motor files' tolerances run courses that the bench could run, with an angle that
    is true, noisy, stuck, lost or drifting. The guard is held against the hottest of them.
    """
    from leactl.errors import InputError
    from leactl.report.challenge import challenge_json, challenge_text
    from leactl.runner.challenge.courses import READINGS
    from leactl.runner.challenge.hunt import hunt, hunts
    from leactl.runner.challenge.optimisers import OPTIMISERS
    from leactl.runner.checked_bench import load_checked
    from leactl.runner.thermal_admission import guard_settings, motors_of

    rates = rate or [20.0, 100.0, 500.0, 1000.0]
    for rate_hz in rates:
        if not 10.0 <= rate_hz <= 10_000.0:
            raise InputError(f"--rate {rate_hz:g}: 10 to 10000 Hz were expected")
    if not 0.0 < minutes <= 10_000.0:
        raise InputError(f"--minutes {minutes:g}: more than 0 and at most 10000 were expected")
    if optimiser not in OPTIMISERS:
        raise InputError(f"--optimiser {optimiser}: one of {', '.join(OPTIMISERS)} was expected")
    file, devices, _document = load_checked(bench)
    motors = motors_of(file)
    settings = guard_settings(file, devices, motors)
    searches = hunts(list(motors.items()), rates, READINGS)
    search_results = []
    for search_number, (role, motor, rate_hz, reading) in enumerate(searches, start=1):
        typer.echo(f"search {search_number} of {len(searches)}: {role}, {rate_hz:g} Hz, {reading} angle", err=True)
        seconds = 60.0 * minutes / len(searches)
        search_results.append(hunt(role, motor, settings, rate_hz, reading, seconds, seed, optimiser=optimiser))
    typer.echo(
        json.dumps(challenge_json(search_results, settings.limit))
        if as_json
        else challenge_text(search_results, settings.limit)
    )
    if beaten_searches := [search for search in search_results if not search.held(settings.limit)]:
        raise SafetyTrip(
            f"{len(beaten_searches)} of {len(search_results)} searches found a winding hotter than the guard lets it be"
        )


def _drill(bench: str, only: list[str], yes: bool, served: bool, bus: list[str], directory: Path) -> "Drilled":
    """Rehearse the faults on an emulated bench in this process, or with a person at a real or served bench."""
    from leactl.report.drill import progress
    from leactl.runner.drill.emulated import EmulatedDrill

    if _is_emulated_here(bench, served, bus):
        with progress() as tell:
            return EmulatedDrill(bench, only, directory, tell).run()
    return _real_drill(bench, only, yes, served, bus, directory).run()


def _planned_drill(bench: str, only: list[str], served: bool, bus: list[str], directory: Path) -> "PlannedDrill":
    """Return the rehearsals that a drill would make, without opening a device."""
    from leactl.runner.drill.emulated import EmulatedDrill

    if _is_emulated_here(bench, served, bus):
        return EmulatedDrill(bench, only, directory, lambda _rehearsal, _done, _count: None).planned()
    return _real_drill(bench, only, True, served, bus, directory).planned()


def _is_emulated_here(bench: str, served: bool, bus: list[str]) -> bool:
    """Return whether the bench is emulated in this process.

    Raises
    ------
    InputError : it is, and `--bus` was given.
    """
    from leactl.errors import InputError
    from leactl.runner.checked_bench import load_checked

    is_in_process = load_checked(bench)[0].emulated is not None and not served
    if is_in_process and bus:
        raise InputError("--bus: an emulated bench has its buses in this process; --served meets another's")
    return is_in_process


def _real_drill(bench: str, only: list[str], yes: bool, served: bool, bus: list[str], directory: Path) -> "RealDrill":
    """Return the drill of a real or served bench, for which a person agrees to each rehearsal.

    Raises
    ------
    InputError : nobody can be asked, and `--yes` was not given.
    """
    from leactl.errors import InputError
    from leactl.runner.drill.real import Person, RealDrill

    is_attended = sys.stdin.isatty() and sys.stderr.isatty()
    if not (yes or is_attended):
        raise InputError("a real bench is asked for before it moves, and stdin is no terminal; --yes agrees to all")
    person = Person(
        agrees=lambda text: yes or confirmed(f"{text}\nGo on?"),
        tell=lambda text: typer.echo(text, err=True),
        present=is_attended,
    )
    return RealDrill(bench, only, directory, person, served, bus)


def _make_folder(directory: Path) -> None:
    """Make the folder of `--out`; raise InputError if that fails."""
    from leactl.errors import InputError
    from leactl.report.outputs import check_folder

    check_folder(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {directory}: {error.strerror or error}") from None


def _write_report(path: Path, text: str, mode: str = "w") -> None:
    """Write a text to the file of `--report`; raise InputError if that fails."""
    from leactl.errors import InputError

    try:
        with path.open(mode, encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise InputError(f"--report {path}: {error.strerror or error}") from None


def _report_command(bench: str, only: list[str], report: Path) -> str:
    """Return the command line that makes this report, as the report shows it."""
    return " ".join(["leactl safety drill", bench, *(f"--only {name}" for name in only), f"--report {report}"])
