"""`leactl motor`: motor files, figures that are derived from them, and motor design."""

import json
from pathlib import Path
from textwrap import indent

import typer

from leactl.cli import finite
from leactl.cli.completion import complete_motor
from leactl.cli.helptext import examples, group_of_commands

app = group_of_commands()
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")
MOTOR = typer.Argument(help="Name of a shipped motor, or a path to a .yaml.", autocompletion=complete_motor)
AMBIENT = typer.Option(
    25.0, "--ambient", min=-40.0, max=60.0, help="Temperature of the air around the actuator [degC].", callback=finite
)
BUS = typer.Option(29.6, "--bus-voltage", min=0.1, max=1000.0, help="Voltage of the drive's bus [V].", callback=finite)


@app.command("list", epilog=examples("motor list"))
def list_motors(as_json: bool = AS_JSON) -> None:
    """List the motors that ship with leactl."""
    from leactl.model.motor import motor_names

    names = motor_names()
    typer.echo(json.dumps({"motors": names}) if as_json else "\n".join(names))


@app.command(epilog=examples("motor show lea --ambient 30"))
def show(motor: str = MOTOR, ambient: float = AMBIENT, bus_voltage: float = BUS, as_json: bool = AS_JSON) -> None:
    """Show one motor by name, or from a YAML file after checking it, with what follows from it."""
    from leactl.model.motor import load_sheet
    from leactl.report.motor_comparison import OperatingConditions, compared_motor, comparison_json, comparison_text

    sheet, document = load_sheet(motor)
    motor_with_figures = compared_motor(motor, OperatingConditions(ambient, bus_voltage))
    if as_json:
        comparison = comparison_json([motor_with_figures])
        figures = {row["name"]: row["values"][0] for row in comparison["rows"]}
        sheet_json = sheet.model_dump(exclude_defaults=True) | {"name": sheet.name}
        figures_json = {"motor_constant": figures["motor_constant"], "figures": figures, "notes": comparison["notes"]}
        typer.echo(json.dumps(sheet_json | figures_json))
        return
    # the derived figures are comments, so that the redirected output is a motor file
    typer.echo(
        document.text.rstrip()
        + "\n\n"
        + indent(comparison_text([motor_with_figures]), "# ", lambda line: True).rstrip()
    )


@app.command(epilog=examples("motor compare lea mine.yaml"))
def compare(
    motors: list[str] = typer.Argument(
        None, metavar="[MOTOR]...", help="Names or paths; all that ship by default.", autocompletion=complete_motor
    ),
    ambient: float = AMBIENT,
    bus_voltage: float = BUS,
    as_json: bool = AS_JSON,
) -> None:
    """Show motors side by side; in N*m and between the leads where their windings differ."""
    from leactl.model.motor import motor_names
    from leactl.report.motor_comparison import OperatingConditions, compared_motor, comparison_json, comparison_text

    compared_motors = [
        compared_motor(name, OperatingConditions(ambient, bus_voltage)) for name in motors or motor_names()
    ]
    typer.echo(json.dumps(comparison_json(compared_motors)) if as_json else comparison_text(compared_motors))


@app.command(epilog=examples("motor scale --radius 60"))
def scale(
    radius: float = typer.Option(
        ..., "--radius", metavar="MM", help="Air-gap radius of the new motor.", callback=finite
    ),
    motor: str = typer.Option("u8-kv100", help="The known motor, by name or path.", autocompletion=complete_motor),
    known_radius: float | None = typer.Option(
        None, "--known-radius", metavar="MM", help="Air-gap radius of the known motor.", callback=finite
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Scale a known motor by its air-gap radius, thickness and length kept, as the LEA was sized."""
    from leactl.model.motor import load_sheet
    from leactl.model.scaling import scaled_figures
    from leactl.report.motor_design import scaled_text

    sheet = load_sheet(motor)[0]
    figures = scaled_figures(sheet, radius / 1e3, None if known_radius is None else known_radius / 1e3)
    if as_json:
        figures_json = [
            {
                "name": figure.name,
                "units": figure.units,
                "power": figure.power,
                "known": figure.known,
                "scaled": figure.scaled,
            }
            for figure in figures
        ]
        typer.echo(
            json.dumps({"motor": sheet.name, "winding": sheet.winding, "radius_mm": radius, "figures": figures_json})
        )
        return
    typer.echo(scaled_text(sheet, figures, radius / 1e3))


@app.command(epilog=examples("motor energy hip.csv knee.csv --body-mass 70"))
def energy(
    cycles: list[Path] = typer.Argument(metavar="CYCLE.csv...", help="Angle and torque of a joint over one cycle."),
    motors: list[str] = typer.Option(
        [], "--motor", help="Names or paths; all that ship by default.", autocompletion=complete_motor
    ),
    stride_time: float | None = typer.Option(None, metavar="S", help="How long a cycle takes.", callback=finite),
    body_mass: float | None = typer.Option(
        None, metavar="KG", help="Body mass, for cycles with torque_Nm_per_kg.", callback=finite
    ),
    ratio: float | None = typer.Option(
        None, help="Turns of the motor for one of the joint; by default the best.", callback=finite
    ),
    efficiency: float = typer.Option(1.0, help="Efficiency of the transmission, in either direction.", callback=finite),
    bus_voltage: float = BUS,
    line_current: float | None = typer.Option(
        None, metavar="A", help="Largest amplitude of the current in a lead of the drive.", callback=finite
    ),
    winding_temperature: float | None = typer.Option(
        None,
        min=-50.0,
        max=250.0,
        metavar="DEGC",
        help="Temperature of the winding; by default the one after many cycles.",
        callback=finite,
    ),
    ambient: float = AMBIENT,
    harmonics: int = typer.Option(10, min=1, max=100, help="Harmonics of the angle that are kept."),
    as_json: bool = AS_JSON,
) -> None:
    """Work out where the energy of a cycle goes, at the ratio of least electrical energy or at a given one."""
    from leactl.model.cycle import read_cycle
    from leactl.model.energy import DriveSupply, best_ratio, remarks, stride
    from leactl.model.motor import load_sheet, motor_names
    from leactl.report.motor_design import energy_text, stride_json

    supply = DriveSupply(bus_voltage, line_current, ambient, winding_temperature)
    sheets = [load_sheet(name)[0] for name in motors or motor_names()]
    cycles_json, texts = [], []
    for path in cycles:
        cycle = read_cycle(path, stride_time, body_mass, harmonics)
        strides = [
            best_ratio(sheet, cycle, efficiency, supply)
            if ratio is None
            else stride(sheet, cycle, ratio, efficiency, supply)
            for sheet in sheets
        ]
        notes_by_motor = [remarks(sheet, motor_stride) for sheet, motor_stride in zip(sheets, strides, strict=True)]
        cycle_json = {
            "cycle": str(path),
            "stride_time_s": cycle.period,
            "angle_harmonics": cycle.harmonics,
            "angle_left_out": cycle.relative_residual,
            "notes": list(cycle.notes),
        }
        rows = zip(sheets, strides, notes_by_motor, strict=True)
        cycles_json.append(cycle_json | {"motors": [stride_json(*row) for row in rows]})
        motor_notes = [
            f"{sheet.name}: {note}" for sheet, notes in zip(sheets, notes_by_motor, strict=True) for note in notes
        ]
        texts.append(energy_text(cycle, sheets, strides, [*cycle.notes, *motor_notes]))
    typer.echo(json.dumps({"cycles": cycles_json}, allow_nan=False) if as_json else "\n".join(texts))


@app.command("preload", epilog=examples("motor preload --gap 0.8"))
def preload_of(
    motor: str = typer.Option("lea", help="Name or path; its file has a `bearings:` block."),
    gap: list[float] = typer.Option(
        [0.0, 0.5, 0.75],
        "--gap",
        metavar="MM",
        help="Gap between flexure and stator; may be repeated.",
        callback=finite,
    ),
    rest_gap: float = typer.Option(
        0.5, "--rest-gap", metavar="MM", help="Gap at which a flexure is at rest.", callback=finite
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Work out the preload of bearings on flexures from their deflection, and whether the bearings take it."""
    from leactl.model.flexures import bearings_of, disagreement, largest_gap, preload, readings
    from leactl.model.motor import load_sheet
    from leactl.report.motor_design import preload_json, preload_text

    bearings = bearings_of(load_sheet(motor)[0])
    gap_readings = readings(bearings, rest_gap / 1e3)
    preloads_by_reading = [
        (reading, [preload(bearings, reading, gap_mm / 1e3) for gap_mm in gap], largest_gap(bearings, reading))
        for reading in gap_readings
    ]
    deviations = disagreement(bearings, gap_readings)
    typer.echo(
        json.dumps(preload_json(bearings, preloads_by_reading, deviations))
        if as_json
        else preload_text(bearings, preloads_by_reading, deviations)
    )
