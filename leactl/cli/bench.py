"""`leactl bench`: bench files."""

import json

import typer

app = typer.Typer(help="List and check bench files.", no_args_is_help=True, rich_markup_mode=None)
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")


@app.command("list")
def list_benches(as_json: bool = AS_JSON) -> None:
    """List the bench files that ship with leactl."""
    from leactl.bench.benchfile import names

    typer.echo(json.dumps({"benches": names()}) if as_json else "\n".join(names()))


@app.command()
def check(bench: str, as_json: bool = AS_JSON) -> None:
    """Check a bench file and every driver's settings in it, without touching a device."""
    from leactl.bench.benchfile import load

    found, devices, _document = load(bench)
    if as_json:
        rows = [{"name": d.name, "driver": d.entry.driver, "role": d.entry.role} for d in devices]
        answer = {"bench": found.name, "devices": rows, "limits": found.limits.model_dump()}
        typer.echo(json.dumps(answer))
        return
    typer.echo(f"{found.name}: {found.title}".rstrip(": "))
    for device in devices:
        typer.echo(f"  {device.name:<16} {device.entry.driver:<10} {device.entry.bus or '-':<6} {device.entry.role}")
    for name, value in found.limits.model_dump().items():
        typer.echo(f"  limit {name:<26} {value:g}")
