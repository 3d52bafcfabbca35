"""`leactl bench`: bench files, their latch, and an emulated bench for drivers in other processes."""

import json
from pathlib import Path

import typer

from leactl.cli import bench_by_hand, bench_check, bench_scan, confirmed
from leactl.cli.completion import complete_bench
from leactl.cli.helptext import ON_A_BENCH, examples, group_of_commands
from leactl.errors import AcceptanceFailed, DeviceError, SafetyTrip

app = group_of_commands()
RUNS = Path("runs")  # default folder of the run files of `leactl run`
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")
SHIPPED = typer.Argument(help="Name of a shipped bench, or a path to a .yaml.", autocompletion=complete_bench)


@app.command("list", epilog=examples("bench list"))
def list_benches(as_json: bool = AS_JSON) -> None:
    """List the bench files that ship with leactl."""
    from leactl.bench.benchfile import names

    typer.echo(json.dumps({"benches": names()}) if as_json else "\n".join(names()))


@app.command(epilog=examples("bench show testbed > mine.yaml"))
def show(bench: str = SHIPPED, as_json: bool = AS_JSON) -> None:
    """Show a bench's file as it is written, to copy and change."""
    from leactl.bench.benchfile import names, shipped_file

    if bench in names():  # it has no faults: no driver has to be loaded to check its settings
        document = shipped_file(bench)
    else:
        from leactl.runner.checked_bench import load_checked

        document = load_checked(bench)[2]
    title = document.data.get("title", "")
    answer = {"name": document.data["name"], "title": title, "file": document.name, "text": document.text}
    typer.echo(json.dumps(answer) if as_json else document.text, nl=as_json)


@app.command(epilog=examples("bench model emulated > nominal.yaml"))
def model(bench: str = SHIPPED, as_json: bool = AS_JSON) -> None:
    """Print the nominal model of a bench, the file that `leactl gap` takes as --model."""
    from leactl.bench.benchfile import nominal_model
    from leactl.runner.checked_bench import load_checked

    file = load_checked(bench)[0]
    text = nominal_model(file)
    typer.echo(json.dumps({"bench": file.name, "text": text}) if as_json else text, nl=as_json)


@app.command(
    epilog=examples(
        "bench reset mine.yaml",
        ends=ON_A_BENCH,
        means={DeviceError: "a run drives the bench", SafetyTrip: "what holds it has changed meanwhile"},
    )
)
def reset(
    bench: str = typer.Argument(
        help="The bench's name as in the message of the trip, or a path to a .yaml.", autocompletion=complete_bench
    ),
    yes: bool = typer.Option(False, "--yes", help="Do not ask."),
    as_json: bool = AS_JSON,
) -> None:
    """State why a bench is tripped and, once confirmed, release it."""
    from leactl.bench.benchfile import load
    from leactl.errors import Stopped
    from leactl.runner import bench_reset

    is_file = Path(bench).suffix in (".yaml", ".yml")
    name = load(bench)[0].name if is_file else bench
    latches = bench_reset.held_by(bench, name)
    trips = latches.trips
    if not trips:
        name = load(bench)[0].name
        typer.echo(json.dumps({"bench": name, "tripped": False}) if as_json else f"{name}: not tripped")
        return
    for trip in trips:
        typer.echo(f"{name}: tripped {trip.time}: {trip.cause} (run {trip.run})", err=True)
    if not (yes or confirmed("The cause is mended and the bench may move again?")):
        raise Stopped(f"not confirmed; '{name}' stays tripped (--yes confirms without a question)")
    bench_reset.release(bench, name, latches)
    trips_json = [{"cause": trip.cause, "time": trip.time, "run": trip.run} for trip in trips]
    answer = {"bench": name, "tripped": False, "released": trips_json[0], "all_released": trips_json}
    typer.echo(json.dumps(answer) if as_json else f"{name}: released")


@app.command(epilog=examples("bench serve emulated --bus can0=pty --setup free", ends=(DeviceError,)))
def serve(
    bench: str = typer.Argument(
        "emulated", help="An emulated bench, by name or as a .yaml.", autocompletion=complete_bench
    ),
    bus: list[str] = typer.Option(
        [], metavar="NAME=INTERFACE:CHANNEL", help="Put a bus elsewhere; can0=pty for slcan."
    ),
    setup: str = typer.Option("coupled", help="free, locked, coupled or heated."),
    condition: str = typer.Option("", help="One of the bench's conditions."),
    seed: int = typer.Option(None, min=0, help="Seed instead of the bench file's."),
) -> None:
    """Serve an emulated bench on real buses, by the wall clock, until Ctrl-C."""
    from leactl.bench.benchfile import changed_buses
    from leactl.bench.records import with_run_folders
    from leactl.emulation.bench.emulated_bench import EmulatedBench
    from leactl.emulation.wires.serving import bridge_buses, stub_chips
    from leactl.emulation.wires.serving import serve as serve_until
    from leactl.runner.checked_bench import load_checked
    from leactl.runner.stop_requests import handled_signals

    file, devices, _document = load_checked(bench)
    file = file.model_copy(update={"buses": file.buses | changed_buses(file, bus)})
    emulated_bench = EmulatedBench(file, with_run_folders(devices, RUNS), setup, condition, seed)
    with handled_signals() as stop, bridge_buses(file, emulated_bench.wires, emulated_bench.serial_wires) as bridges:
        chips = stub_chips(file, emulated_bench)
        for name, bridge in bridges.items():
            typer.echo(f"{name}: {bridge.address}")
        for name, chips_of_bus in chips.items():
            if chips_of_bus:
                typer.echo(f"{name}: i2c-stub")
            else:
                typer.echo(f"{name}: is not served; I2C needs the kernel's i2c-stub at that number", err=True)
        for text in emulated_bench.inactive_faults:
            typer.echo(text, err=True)
        typer.echo("serving; Ctrl-C ends it")
        all_chips = [chip for chips_of_bus in chips.values() for chip in chips_of_bus]
        serve_until(emulated_bench.time, list(bridges.values()), all_chips, lambda: bool(stop.cause))


@app.command(epilog=examples("bench faults", "bench faults frozen_drive"))
def faults(name: str = typer.Argument("", help="One fault, to be explained."), as_json: bool = AS_JSON) -> None:
    """List the faults that an emulated bench rehearses, or explain one: its parameters and a line for a bench file."""
    from leactl.emulation.faults import find_fault, known_faults
    from leactl.report.terminal import list_line

    chosen_faults = {name: find_fault(name)} if name else known_faults()
    descriptions = [fault.described(key) for key, fault in sorted(chosen_faults.items())]
    if as_json:
        typer.echo(json.dumps({"faults": descriptions}))
        return
    width = max(len(fault["fault"]) for fault in descriptions)
    for fault in descriptions:
        typer.echo(list_line(f"{fault['fault']:<{width}} ", fault["summary"]))
    if name:
        for key, text in descriptions[0]["parameters"].items():
            typer.echo(list_line(f"  {key:<18} ", text))
        typer.echo(f"\nemulated:\n  faults:\n    - {descriptions[0]['example']}")


app.command(
    "check",
    epilog=examples(
        "bench check mine.yaml",
        "bench check mine.yaml --devices",
        "bench check mine.yaml --move --dry-run",
        "bench check mine.yaml --move --current 1.5",
        ends=(*ON_A_BENCH, AcceptanceFailed),
        means={AcceptanceFailed: "the bench contradicts its file"},
    ),
)(bench_check.check)
app.command(
    "scan",
    epilog=examples(
        "bench scan",
        "bench scan --can can0 --serial /dev/ttyUSB0 --yaml",
        "bench scan --lan 192.168.0.10 --i2c 1",
        ends=(DeviceError,),
        means={DeviceError: "a wire is absent or in use or fails; the others are asked"},
    ),
)(bench_scan.scan)
app.command(
    "stop",
    epilog=examples(
        "bench stop",
        "bench stop mine.yaml --wait 10",
        ends=(DeviceError,),
        means={DeviceError: "a device has not confirmed that it is safe or a run cannot be asked"},
    ),
)(bench_by_hand.stop)
app.command("pause", epilog=examples("bench pause mine.yaml", ends=ON_A_BENCH))(bench_by_hand.pause)
app.command("resume", epilog=examples("bench resume mine.yaml", ends=ON_A_BENCH))(bench_by_hand.resume)
app.command("remark", epilog=examples('bench remark "the bearing squeaks" mine.yaml', ends=ON_A_BENCH))(
    bench_by_hand.remark
)
app.command(
    "read",
    epilog=examples(
        "bench read mine.yaml",
        "bench read mine.yaml --for 5 --json",
        "bench read mine.yaml --follow --every 5 --channel torque",
        ends=ON_A_BENCH,
    ),
)(bench_by_hand.read)
app.command("recording", epilog=examples("bench recording drive_test mine.yaml --out step.csv", ends=(DeviceError,)))(
    bench_by_hand.recording
)
app.command("zero", epilog=examples("bench zero mine.yaml", ends=ON_A_BENCH))(bench_by_hand.zero)
app.command(
    "jog",
    epilog=examples(
        "bench jog mine.yaml --role test --current 1.5 --for 1",
        "bench jog mine.yaml --role load --velocity 2 --for 3",
        "bench jog mine.yaml --angle 0.1 --dry-run",
        ends=ON_A_BENCH,
    ),
)(bench_by_hand.jog)
