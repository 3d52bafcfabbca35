"""`leactl stats`: compare results between conditions."""

import json
from pathlib import Path

import typer

from leactl.cli import finite
from leactl.cli.helptext import examples, single_command

app = single_command()


@app.command(epilog=examples("stats runs", "stats runs --result torque_constant --json"))
def stats(
    runs: list[Path] = typer.Argument(
        metavar="RUN...", help="Runs or folders, under two conditions or more, or answers of `analyze --json`."
    ),
    result: list[str] = typer.Option([], "--result", help="Results to compare; all with an uncertainty by default."),
    by_run: bool = typer.Option(False, "--by-run", help="Use one value for each run instead of one for each repeat."),
    torque_constant: float | None = typer.Option(
        None,
        metavar="N*m/A",
        help="Torque constant for friction, in place of the one in the runs' model.",
        callback=finite,
    ),
    settings: list[str] = typer.Option(
        [], "--set", metavar="NAME=NUMBER", help="Set a numeric option of the analysis, such as phase_resistance=0.28."
    ),
    as_json: bool = typer.Option(False, "--json", help="Print JSON on stdout."),
) -> None:
    """Compare results over conditions: ANOVA with the actuator as a random factor, Tukey HSD, effect sizes."""
    from leactl.analysis.analyze import numeric_options
    from leactl.analysis.anova.by_experiment import compare_each
    from leactl.errors import InputError
    from leactl.report.conditions import comparisons_text

    options = numeric_options(settings, torque_constant=torque_constant)
    experiments, not_compared, faults = compare_each(runs, result, by_run, **options)
    for line in not_compared:
        typer.echo(f"leactl: not compared: {line}", err=True)
    if as_json and len(experiments) == 1 and not (not_compared or faults):
        typer.echo(json.dumps(experiments[0].as_json(), allow_nan=False))
    elif as_json:
        body = {
            "comparisons": [compared.as_json() for compared in experiments],
            "not_compared": not_compared,
            "faults": InputError(faults).as_json(),
        }
        typer.echo(json.dumps(body, allow_nan=False))
    else:
        typer.echo(
            "\n\n".join(
                comparisons_text(compared.experiment, compared.comparisons, compared.refused)
                for compared in experiments
            )
        )
    if faults:
        raise InputError(faults)
