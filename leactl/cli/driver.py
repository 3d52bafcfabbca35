"""`leactl driver`: list, explain, check and begin drivers, and replay the trace of a run on them."""

import json
from pathlib import Path

import typer

from leactl.cli.completion import complete_bench, complete_driver
from leactl.cli.helptext import examples, group_of_commands
from leactl.errors import DeviceError, InputError

app = group_of_commands()
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")
NAME = typer.Argument(help="Name of a driver plug-in.", autocompletion=complete_driver)


@app.command("list", epilog=examples("driver list"))
def list_drivers(as_json: bool = AS_JSON) -> None:
    """List every registered driver, broken ones included."""
    from leactl.driver import registry
    from leactl.report.terminal import list_line

    listings = registry.survey()
    if as_json:
        rows = [
            {
                "name": listing.name,
                "source": listing.source,
                "transport": listing.driver.transport if listing.driver else None,
                "summary": listing.driver.summary if listing.driver else None,
                "error": listing.error or None,
            }
            for listing in listings
        ]
        typer.echo(json.dumps({"drivers": rows}))
        return
    width = max((len(listing.name) for listing in listings), default=0)
    for listing in listings:
        transport, summary = (
            (listing.driver.transport, listing.driver.summary) if listing.driver else ("broken", listing.error)
        )
        typer.echo(list_line(f"{listing.name:<{width}} {transport:<7} ", summary))


@app.command(epilog=examples("driver info elmo_can"))
def info(name: str = NAME, as_json: bool = AS_JSON) -> None:
    """Explain one driver's settings: name, type, default and range of each."""
    from leactl.driver import registry

    driver = registry.load(name)
    schema, transports = driver.Settings.model_json_schema(), (driver.transport, *driver.further_transports)
    if as_json:
        description = {"name": name, "transport": driver.transport, "summary": driver.summary, "settings": schema}
        typer.echo(json.dumps(description))
        return
    typer.echo(f"{name}: {driver.summary} (bus: {' or '.join(transports)})")
    for setting, setting_schema in schema["properties"].items():
        default_text = (
            "required" if setting in schema.get("required", ()) else f"default {setting_schema.get('default')}"
        )
        type_text = setting_schema.get("type") or setting_schema.get("$ref", "").rpartition("/")[2] or "choice"
        bounds = [
            f"{word} {setting_schema[key]}"
            for key, word in (("minimum", ">="), ("maximum", "<="))
            if key in setting_schema
        ]
        typer.echo(f"  {setting:<26} {type_text:<9} {default_text:<14} {' '.join(bounds)}".rstrip())


@app.command(epilog=examples("driver check elmo_can", means={InputError: "a check fails or there is no such driver"}))
def check(name: str = NAME, as_json: bool = AS_JSON) -> None:
    """Hold a driver against the contract, and try it on its own far end: readings, setpoints, silence, its end."""
    from leactl.driver import conformance, registry
    from leactl.emulation.trial.running import try_driver

    driver = registry.load(name)
    faults = conformance.faults_of(driver)
    trial_results = [] if faults else try_driver(driver)
    faults += [f"{result.name}: {result.fault}" for result in trial_results if result.fault]
    if as_json:
        rows = [{"name": result.name, "fault": result.fault or None} for result in trial_results]
        typer.echo(json.dumps({"name": name, "passed": not faults, "faults": faults, "tried": rows}))
    if faults:
        raise InputError([f"driver '{name}': {fault}" for fault in faults])
    if not as_json:
        typer.echo(f"{name}: keeps the driver contract, in {len(trial_results)} trials on its far end")
        for result in trial_results:
            typer.echo(f"  {result.name}")


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
    emulator_function = "answer_of" if bus == "serial" else "register_of"
    typer.echo(f"\nFill in value_of in driver.py and {emulator_function} in emulator.py, then:")
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
    bench: str = typer.Option(..., "--bench", help="The run's bench file.", autocompletion=complete_bench),
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
