"""`leactl analyze`: fit the parameters that runs were made for."""

import json
from pathlib import Path

import typer

from leactl.cli import finite
from leactl.cli.helptext import examples, single_command

app = single_command()


@app.command(epilog=examples("analyze runs", "analyze RUN.h5 --json"))
def analyze(
    runs: list[Path] = typer.Argument(
        metavar="RUN...", help="Run files or folders; repeats are combined, experiments kept apart."
    ),
    as_json: bool = typer.Option(
        False,
        "--json",
        help="Print JSON on stdout: the analysis itself if it is the only one, else an object with `analyses` and"
        " `faults`.",
    ),
    experiment: str = typer.Option(
        "", "--as", metavar="NAME", help="Analyse as this experiment, such as channels, which takes every protocol."
    ),
    channel: list[str] = typer.Option(
        [], "--channel", metavar="NAME", help="With --as channels: only this channel, such as torque; may be repeated."
    ),
    torque_constant: float | None = typer.Option(
        None,
        metavar="N*m/A",
        help="Torque constant for friction and back-emf, in place of the one in the run's model.",
        callback=finite,
    ),
    torque_constant_std: float | None = typer.Option(
        None,
        metavar="N*m/A",
        help="Standard uncertainty of --torque-constant; it is added to that of the results.",
        callback=finite,
    ),
    processes: int = typer.Option(
        1, "--processes", min=1, help="Number of runs to read at a time; it does not change the results."
    ),
    scheduler: str = typer.Option(
        "", "--scheduler", metavar="ADDRESS", help="Read and analyse on the workers of this Dask scheduler."
    ),
    assignments: list[str] = typer.Option(
        [], "--set", metavar="NAME=NUMBER", help="Set a numeric option of the analysis, such as camera_gain_std=0.01."
    ),
) -> None:
    """Fit the parameters that runs were made for, with 95 % intervals, by actuator and condition."""
    from leactl.analysis.analyze import GENERIC_ANALYSIS, analyze_each, numeric_options
    from leactl.analysis.estimate import FORMAT, VERSION
    from leactl.errors import InputError
    from leactl.runfile.catalog.summaries import run_files
    from leactl.scheduler import workers_of

    options = numeric_options(assignments, torque_constant=torque_constant, torque_constant_std=torque_constant_std)
    # "generic" is another name of the analysis "channels"
    experiment_name = GENERIC_ANALYSIS if experiment == "generic" else experiment
    folders = [path for path in runs if path.is_dir()]
    files = [file for path in runs for file in (run_files([path]) if path in folders else [path])]
    with workers_of(processes, scheduler) as workers:
        results, faults = analyze_each(files, experiment_name, workers, channel=channel or None, **options)
    # with a folder among the arguments, faults are reported beside the results; else nothing is printed
    if faults and not (results and folders):
        raise InputError(faults)
    if as_json and len(results) == 1 and not faults:
        typer.echo(json.dumps(results[0].as_json(), allow_nan=False))
    elif as_json:
        head = {"format": FORMAT, "format_version": VERSION}
        body = {"analyses": [result.as_json() for result in results], "faults": InputError(faults).as_json()}
        typer.echo(json.dumps(head | body, allow_nan=False))
    else:
        from leactl.report.terminal import print_result

        for index, result in enumerate(results):
            typer.echo("\n" if index else "", nl=False)
            print_result(result)
    if faults:
        raise InputError(faults)
