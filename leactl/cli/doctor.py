"""`leactl doctor`: list what is installed on this machine and what is missing, with the commands that install it."""

import json

import typer

from leactl.cli.helptext import examples, single_command
from leactl.errors import InputError

app = single_command()


@app.command(epilog=examples("doctor", "doctor --json", means={InputError: "something needed is missing"}))
def doctor(as_json: bool = typer.Option(False, "--json", help="Print JSON on stdout.")) -> None:
    """Check Python, packages, plug-ins, buses, browser and disk."""
    from dataclasses import asdict

    from leactl.bench.host_checks import run_checks
    from leactl.report import pdf
    from leactl.report.terminal import list_line
    from leactl.runner import state_folder

    findings = [*run_checks(), state_folder.examine(), pdf.examine()]
    missing = [finding for finding in findings if finding.needed and not finding.fine]
    if as_json:
        typer.echo(json.dumps({"fine": not missing, "findings": [asdict(finding) for finding in findings]}))
    else:
        for finding in findings:
            mark = "ok     " if finding.fine else "MISSING" if finding.needed else "absent "
            typer.echo(list_line(f"{mark} ", f"{finding.subject}: {finding.found}"))
            if finding.mend:
                typer.echo(list_line("        mend: ", finding.mend))
    if missing:
        raise typer.Exit(2)
