"""`leactl stats`: whether results differ between conditions."""

import json
from pathlib import Path

import typer

from leactl.cli import finite


def stats(
    runs: list[Path] = typer.Argument(
        metavar="RUN...", help="Runs of one experiment under two conditions or more, or answers of `analyze --json`."
    ),
    result: list[str] = typer.Option([], "--result", help="Results to compare; all with an uncertainty by default."),
    by_run: bool = typer.Option(False, "--by-run", help="One value a run instead of one for each of its repeats."),
    torque_constant: float | None = typer.Option(
        None, metavar="N*m/A", help="Torque constant for friction.", callback=finite
    ),
    settings: list[str] = typer.Option(
        [], "--set", metavar="NAME=NUMBER", help="What the analysis may be told, such as phase_resistance=0.28."
    ),
    as_json: bool = typer.Option(False, "--json", help="Print JSON on stdout."),
) -> None:
    """Compare results over conditions: ANOVA with the actuator as a random factor, Tukey HSD, effect sizes."""
    from leactl.analysis.conditions.comparison import compare_all
    from leactl.analysis.experiments import numbers
    from leactl.report.conditions import comparisons_text

    experiment, found, refused = compare_all(runs, result, by_run, **numbers(settings, torque_constant=torque_constant))
    if as_json:
        body = {"experiment": experiment, "results": [one.as_json() for one in found], "not_compared": refused}
        typer.echo(json.dumps(body, allow_nan=False))
        return
    typer.echo(comparisons_text(experiment, found, refused))
