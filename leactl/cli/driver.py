"""`leactl driver`: list drivers and their settings, and check them against the driver contract."""

import json
from pathlib import Path

import typer

from leactl.cli.completion import benches, drivers
from leactl.cli.helptext import examples, group_of_commands
from leactl.errors import DeviceError, InputError

app = group_of_commands()
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")
NAME = typer.Argument(help="Name of a driver plug-in.", autocompletion=drivers)


@app.command("list", epilog=examples("driver list"))
def list_drivers(as_json: bool = AS_JSON) -> None:
    """List every registered driver, broken ones included."""
    from leactl.driver import registry
    from leactl.report.terminal import list_line

    drivers = registry.survey()
    if as_json:
        rows = [
            {
                "name": item.name,
                "source": item.source,
                "transport": item.driver.transport if item.driver else None,
                "summary": item.driver.summary if item.driver else None,
                "error": item.error or None,
            }
            for item in drivers
        ]
        typer.echo(json.dumps({"drivers": rows}))
        return
    width = max((len(item.name) for item in drivers), default=0)
    for item in drivers:
        transport, text = (item.driver.transport, item.driver.summary) if item.driver else ("broken", item.error)
        typer.echo(list_line(f"{item.name:<{width}} {transport:<7} ", text))


@app.command(epilog=examples("driver info elmo_can"))
def info(name: str = NAME, as_json: bool = AS_JSON) -> None:
    """Explain one driver's settings: name, type, default and range of each."""
    from leactl.driver import registry

    driver = registry.load(name)
    schema, kinds = driver.Settings.model_json_schema(), (driver.transport, *driver.further_transports)
    if as_json:
        described = {"name": name, "transport": driver.transport, "summary": driver.summary, "settings": schema}
        typer.echo(json.dumps(described))
        return
    typer.echo(f"{name}: {driver.summary} (bus: {' or '.join(kinds)})")
    for field, body in schema["properties"].items():
        needed = "required" if field in schema.get("required", ()) else f"default {body.get('default')}"
        kind = body.get("type") or body.get("$ref", "").rpartition("/")[2] or "choice"
        bounds = [f"{word} {body[key]}" for key, word in (("minimum", ">="), ("maximum", "<=")) if key in body]
        typer.echo(f"  {field:<26} {kind:<9} {needed:<14} {' '.join(bounds)}".rstrip())


@app.command(epilog=examples("driver check elmo_can", means={InputError: "a check fails or there is no such driver"}))
def check(name: str = NAME, as_json: bool = AS_JSON) -> None:
    """Hold a driver against the contract, and try it on its own far end: readings, setpoints, silence, its end."""
    from leactl.driver import conformance, registry
    from leactl.emulation.trial.running import try_driver

    driver = registry.load(name)
    faults = conformance.faults_of(driver)
    tried = [] if faults else try_driver(driver)
    faults += [f"{trial.name}: {trial.fault}" for trial in tried if trial.fault]
    if as_json:
        rows = [{"name": trial.name, "fault": trial.fault or None} for trial in tried]
        typer.echo(json.dumps({"name": name, "passed": not faults, "faults": faults, "tried": rows}))
    if faults:
        raise InputError([f"driver '{name}': {fault}" for fault in faults])
    if not as_json:
        typer.echo(f"{name}: keeps the driver contract, in {len(tried)} trials on its far end")
        for trial in tried:
            typer.echo(f"  {trial.name}")


@app.command(
    epilog=examples("driver new scale --quantity torque", "driver new tmp117 --bus i2c --quantity ambient_temperature")
)
def new(
    name: str = typer.Argument(help="Name of the driver, as bench files will have it."),
    bus: str = typer.Option("serial", "--bus", help="What the device hangs on: serial or i2c."),
    quantity: str = typer.Option(..., "--quantity", help="What it measures, such as torque or bus_voltage."),
    into: Path = typer.Option(Path(), "--into", help="Where the folder of the package is made."),
    as_json: bool = AS_JSON,
) -> None:
    """Write a package with a driver, its emulator and tests; two functions are left to fill in."""
    from leactl.driver.scaffold import write_package

    folder = write_package(name, bus, quantity, into)
    files = sorted(str(path) for path in folder.rglob("*") if path.is_file())
    if as_json:
        typer.echo(json.dumps({"name": name, "folder": str(folder), "files": files}))
        return
    typer.echo("\n".join(files))
    second = "answer_of" if bus == "serial" else "register_of"
    typer.echo(f"\nFill in value_of in driver.py and {second} in emulator.py, then:")
    typer.echo(f"  pip install -e {folder} && leactl driver check {name} && pytest {folder}")


@app.command(
    epilog=examples(
        "driver replay run.trace --bench mine.yaml",
        ends=(DeviceError,),
        means={DeviceError: "a driver sent or ended otherwise than the trace has it"},
    )
)
def replay(
    trace: Path = typer.Argument(help="A file that --trace has written."),
    bench: str = typer.Option(..., "--bench", help="The run's bench file.", autocompletion=benches),
    as_json: bool = AS_JSON,
) -> None:
    """Make the calls of a trace again on the drivers, its wires answering as they did, and say where they differ."""
    from leactl.bench import benchfile, wire_replay

    file, devices, _document = benchfile.load(bench)
    replayed = wire_replay.replay(trace, file, devices)
    if as_json:
        body = replayed._asdict() | {"difference": replayed.difference and replayed.difference._asdict()}
        typer.echo(json.dumps(body))
    else:
        typer.echo(f"{trace}: {replayed.calls} calls ended as they did, {replayed.transfers} transfers were the same")
        if replayed.cut_short:
            typer.echo("  the trace ends within a call")
        for text in replayed.raised:
            typer.echo(f"  as then: {text}")
    if replayed.difference is not None:
        raise DeviceError(f"{trace}:{replayed.difference.line}  {replayed.difference}")
