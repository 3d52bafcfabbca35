"""`leactl motor`: parameter sets of actuators."""

import json

import typer

app = typer.Typer(help="List and show motor parameter sets.", no_args_is_help=True, rich_markup_mode=None)
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")


@app.command("list")
def list_motors(as_json: bool = AS_JSON) -> None:
    """List the motors that ship with leactl."""
    from leactl.model.motor import motor_names

    names = motor_names()
    typer.echo(json.dumps({"motors": names}) if as_json else "\n".join(names))


@app.command()
def show(motor: str, as_json: bool = AS_JSON) -> None:
    """Show one motor by name, or from a YAML file after checking it."""
    from leactl.model.motor import load_motor

    found, document = load_motor(motor)
    if as_json:
        typer.echo(json.dumps(found.model_dump() | {"motor_constant": found.motor_constant}))
        return
    typer.echo(document.text.rstrip())
    typer.echo(f"# motor constant {found.motor_constant:.3f} N*m/sqrt(W)")
