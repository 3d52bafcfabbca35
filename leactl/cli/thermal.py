"""`leactl thermal`: what windings may carry, how warm they may be, and what a protocol would do to them."""

import json
from pathlib import Path
from typing import Any

import typer

from leactl.cli import finite
from leactl.cli.completion import benches, motors, protocols, settings
from leactl.cli.helptext import examples, group_of_commands

app = group_of_commands()
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")
AMBIENT = typer.Option(
    25.0, "--ambient", min=-40.0, max=60.0, help="Of the air around the actuator [degC].", callback=finite
)
BENCH = typer.Option("emulated", help="Name of a shipped bench, or a path to a .yaml.", autocompletion=benches)
SET = typer.Option([], "--set", metavar="NAME=VALUE", help="Set a parameter of the protocol.", autocompletion=settings)
ACTUATOR = typer.Option("", help="Label of the one under test.")
COLD = typer.Option(False, "--cold", help="Nothing has heated the actuators.")


@app.command(epilog=examples("thermal limits --motor lea --ambient 30"))
def limits(
    motor: str = typer.Option("lea", help="Name of a shipped motor, or a path to a .yaml.", autocompletion=motors),
    ambient: float = AMBIENT,
    speed: list[float] = typer.Option(
        [31.4], min=0.0, max=1000.0, help="Further speeds [rad/s], for the heat of friction.", callback=finite
    ),
    as_json: bool = AS_JSON,
) -> None:
    """State continuous and peak current and torque: guaranteed over the motor's tolerances, nominal, favourable."""
    from dataclasses import asdict

    from leactl.model.motor import load_motor
    from leactl.report.thermal import limits_text
    from leactl.safety.thermal.capability import PEAKS_S, continuous, peaks

    found = load_motor(motor)[0]
    held = continuous(found, ambient, speed)
    short = peaks(found, ambient, PEAKS_S)
    if as_json:
        body = {
            "motor": found.name,
            "ambient_degC": ambient,
            "winding_limit_degC": found.limits.winding_temperature,
            "continuous": [asdict(one) for one in held],
            "peak": [asdict(one) for one in short],
        }
        typer.echo(json.dumps(body))
        return
    typer.echo(limits_text(found, ambient, held, short))


@app.command(epilog=examples("thermal state --bench emulated"))
def state(
    bench: str = BENCH, actuator: str = typer.Option("", help="Label of the one under test."), as_json: bool = AS_JSON
) -> None:
    """Show how warm the windings of a bench may be by now, and how that is known."""
    from leactl.report.thermal import state_text
    from leactl.runner.checked_bench import load_checked
    from leactl.runner.windings import Windings

    file, devices, _document = load_checked(bench)
    windings = Windings(file, devices, actuator)
    rows: list[dict[str, Any]] = [
        {
            "role": role,
            "actuator": windings.names[role],
            "hottest_phase_degC": round(float(found.nodes[0]), 2),
            "winding_degC": round(float(found.nodes[1]), 2),
            "housing_degC": round(float(found.nodes[2]), 2),
            "limit_degC": windings.settings.limit,
            "known": found.known,
        }
        for role, found in windings.recalled.items()
    ]
    typer.echo(json.dumps({"bench": file.name, "windings": rows}) if as_json else state_text(file.name, rows))


@app.command(epilog=examples("thermal fit runs --motor lea"))
def fit(
    runs: list[Path] = typer.Argument(
        metavar="RUN...", help="Runs or folders; those with temperatures of winding, housing and ambient are fitted."
    ),
    motor: str = typer.Option("lea", help="Name of a shipped motor, or a path to a .yaml.", autocompletion=motors),
    as_json: bool = AS_JSON,
) -> None:
    """Fit the thermal network and the resistance of each actuator, and state the tolerances that its runs leave."""
    from leactl.model.motor import load_motor
    from leactl.report.thermal import fit_text
    from leactl.report.thermal_fits import thermal_fits

    found, left_out = thermal_fits(runs, load_motor(motor)[0])
    for line in left_out:
        typer.echo(f"leactl: left out: {line}", err=True)
    if as_json:
        several = {"fits": [one.as_json() for one in found], "left_out": left_out}
        typer.echo(json.dumps({**found[0].as_json(), "left_out": left_out} if len(found) == 1 else several))
    else:
        typer.echo("\n\n".join(fit_text(one) for one in found))


@app.command(epilog=examples("thermal plan thermal --bench emulated-heated --cold"))
def plan(
    protocol: str = typer.Argument(help="Name of a shipped protocol, or a path to a .yaml.", autocompletion=protocols),
    bench: str = BENCH,
    overrides: list[str] = SET,
    condition: str = typer.Option("", help="Condition of the run."),
    actuator: str = ACTUATOR,
    cold: bool = COLD,
    as_json: bool = AS_JSON,
) -> None:
    """Forecast how hot a protocol may make the windings, and the waits that would keep them below the limit."""
    from leactl.errors import InputError
    from leactl.protocol.protocolfile import load, read_overrides
    from leactl.report.thermal import forecast_text
    from leactl.runner.checked_bench import load_checked
    from leactl.runner.windings import Windings

    file, devices, _document = load_checked(bench)
    expanded = load(protocol, read_overrides(overrides), condition)
    windings = Windings(file, devices, actuator, cold=cold)
    found = windings.forecast(expanded)
    longer = expanded
    if found.passing is not None:
        try:
            longer = windings.approved(expanded, insert_cooldown=True)
        except InputError:
            longer = expanded
    waits = [row for row in longer.timeline() if row.name == "cooldown"]
    body = {
        "protocol": expanded.name,
        "limit_degC": windings.settings.limit,
        "peaks_degC": {role: round(value, 2) for role, value in found.peaks.items()},
        "passes": None
        if found.passing is None
        else {"step": found.passing.step, "time_s": round(found.passing.time_s, 2), "role": found.passing.role},
        "turning_from_Hz": found.turning_from_hz,
        "cooldowns": [{"start_s": round(row.start_s, 3), "duration_s": row.duration_s} for row in waits],
    }
    typer.echo(json.dumps(body) if as_json else forecast_text(body))
