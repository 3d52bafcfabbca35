"""The entry point: commands found by noun, errors as one line each on stderr, the documented exit statuses."""

import sys

import typer

from leactl import __version__
from leactl.cli import bench, driver, motor, runs
from leactl.errors import InputError, LeactlError

app = typer.Typer(
    name="leactl",
    help="Characterise electric actuators: protocols in, HDF5 runs and fitted parameters out.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.add_typer(bench.app, name="bench")
app.add_typer(driver.app, name="driver")
app.add_typer(motor.app, name="motor")
app.add_typer(runs.app, name="runs")


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"leactl {__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: bool = typer.Option(False, "--version", callback=_show_version, is_eager=True, help="Print the version."),
) -> None:
    """Characterise electric actuators: protocols in, HDF5 runs and fitted parameters out."""


def main() -> None:
    """Run the command line; a known error is one line on stderr and its exit status."""
    try:
        app()
    except InputError as error:
        for fault in error.faults:
            print(f"leactl: {fault}", file=sys.stderr)
        sys.exit(error.exit_status)
    except LeactlError as error:
        print(f"leactl: {error}", file=sys.stderr)
        sys.exit(error.exit_status)
