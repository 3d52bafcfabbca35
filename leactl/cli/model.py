"""`leactl model`: read models of other simulators as model files, and write augmented models back to them."""

import json
from enum import StrEnum
from pathlib import Path

import typer

from leactl.cli import finite
from leactl.cli.helptext import examples, group_of_commands

app = group_of_commands()
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")


class Ctrl(StrEnum):
    """Unit of `ctrl` for a torque actuator in MJCF."""

    TORQUE = "torque"
    CURRENT = "current"


class Format(StrEnum):
    """File format of an augmented model."""

    MJCF = "mjcf"
    JSON = "json"
    URDF = "urdf"


CTRL = typer.Option(Ctrl.TORQUE, "--ctrl", help="What ctrl of a torque actuator is: torque, or the current in A.")


@app.command(
    "import",
    epilog=examples(
        "model import robot.xml --joint knee --supply 24 --out nominal.yaml",
        "model import robot.urdf --joint knee --json",
    ),
)
def import_model(
    robot: Path = typer.Argument(help="MJCF or URDF file."),
    joint: str = typer.Option(..., "--joint", help="Joint in the file."),
    out: Path | None = typer.Option(None, "--out", help="New model file; by default it is printed."),
    supply: float | None = typer.Option(
        None, "--supply", min=0.1, max=1000.0, help="Supply voltage of a position servo [V].", callback=finite
    ),
    ctrl: Ctrl = CTRL,
    as_json: bool = AS_JSON,
) -> None:
    """Read one joint of an MJCF or URDF file as a model file, and say what that file lacks; needs leactl[mujoco]."""
    from leactl.exchange.robot_joint import import_joint
    from leactl.runfile.publish import new_file, refuse_existing

    if out is not None:
        refuse_existing(out)
    imported = import_joint(robot, joint, supply, ctrl is Ctrl.CURRENT)
    if out is not None:
        with new_file(out) as path:
            path.write_text(imported.text, encoding="utf-8")
    if as_json:
        typer.echo(json.dumps(imported.as_json() | {"file": None if out is None else str(out)}))
        return
    typer.echo(imported.text if out is None else str(out), nl=out is not None)
    for key, reason in imported.missing.items():
        typer.echo(f"missing: {key}: {reason}", err=True)
    for note in imported.notes:
        typer.echo(f"note: {note}", err=True)


@app.command(
    "export",
    epilog=examples(
        "model export augmented.yaml --to mjcf --into robot.xml --out new.xml",
        "model export augmented.yaml --to json --timestep 0.005 > knee.json",
    ),
)
def export_model(
    model: Path = typer.Argument(help="Model file, as `gap diagnose --write-model` writes it."),
    to: Format = typer.Option(..., "--to", help="mjcf or urdf, a patch of --into; json, a table for any simulator."),
    into: Path | None = typer.Option(None, "--into", help="MJCF or URDF file that is patched into --out."),
    joint: str | None = typer.Option(None, "--joint", help="Joint in the file; by default the model's name."),
    out: Path | None = typer.Option(None, "--out", help="New file; a table is printed by default."),
    callbacks: Path | None = typer.Option(None, "--callbacks", help="New .py for MuJoCo with what MJCF cannot hold."),
    timestep: float | None = typer.Option(
        None, "--timestep", min=1e-6, max=1.0, help="Time step in which a table states delays [s].", callback=finite
    ),
    ctrl: Ctrl = CTRL,
    as_json: bool = AS_JSON,
) -> None:
    """Write a model, effects and all, for MuJoCo, URDF or others: what the file can hold into it, the rest as code."""
    from leactl.exchange.export_request import ExportRequest, export

    request = ExportRequest(model, to.value, into, joint, out, callbacks, timestep, ctrl is Ctrl.CURRENT)
    exported = export(request)
    if exported.text is not None:
        typer.echo(exported.text)
        return
    if as_json:
        typer.echo(json.dumps(exported.as_json()))
        return
    for path in exported.written:
        typer.echo(str(path))
    for line in exported.lines:
        typer.echo(line, err=True)
