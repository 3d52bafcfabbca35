"""`leactl thermal`: current limits, state, fits and forecasts of windings, and the commissioning of an actuator."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from leactl.cli import TRACE, finite, traced_to
from leactl.cli.completion import complete_bench, complete_motor, complete_protocol, complete_setting
from leactl.cli.helptext import ON_A_BENCH, examples, group_of_commands
from leactl.cli.run import ATTENDED
from leactl.errors import AcceptanceFailed

if TYPE_CHECKING:
    from leactl.runner.request import Request

app = group_of_commands()
AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")
AMBIENT = typer.Option(
    25.0, "--ambient", min=-40.0, max=60.0, help="Temperature of the air around the actuator [degC].", callback=finite
)
BENCH = typer.Option("emulated", help="Name of a shipped bench, or a path to a .yaml.", autocompletion=complete_bench)
SET = typer.Option(
    [], "--set", metavar="NAME=VALUE", help="Set a parameter of the protocol.", autocompletion=complete_setting
)
ACTUATOR = typer.Option("", help="Label of the actuator under test.")
COLD = typer.Option(False, "--cold", help="Nothing has heated the actuators.")


@app.command(epilog=examples("thermal limits --motor lea --ambient 30"))
def limits(
    motor: str = typer.Option(
        "lea", help="Name of a shipped motor, or a path to a .yaml.", autocompletion=complete_motor
    ),
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
    from leactl.safety.thermal.guarded_currents import PEAKS_S, continuous, peaks

    motor_model = load_motor(motor)[0]
    continuous_limits = continuous(motor_model, ambient, speed)
    peak_limits = peaks(motor_model, ambient, PEAKS_S)
    if as_json:
        body = {
            "motor": motor_model.name,
            "ambient_degC": ambient,
            "winding_limit_degC": motor_model.limits.winding_temperature,
            "continuous": [asdict(point) for point in continuous_limits],
            "peak": [asdict(point) for point in peak_limits],
        }
        typer.echo(json.dumps(body))
        return
    typer.echo(limits_text(motor_model, ambient, continuous_limits, peak_limits))


@app.command(epilog=examples("thermal state --bench emulated"))
def state(
    bench: str = BENCH,
    actuator: str = ACTUATOR,
    as_json: bool = AS_JSON,
) -> None:
    """Show how warm the windings of a bench may be by now, and how that is known."""
    from leactl.report.thermal import state_text
    from leactl.runner.checked_bench import load_checked
    from leactl.runner.thermal_admission import Windings

    file, devices, _document = load_checked(bench)
    windings = Windings(file, devices, actuator)
    rows: list[dict[str, Any]] = [
        {
            "role": role,
            "actuator": windings.names[role],
            "hottest_phase_degC": round(float(estimate.nodes[0]), 2),
            "winding_degC": round(float(estimate.nodes[1]), 2),
            "housing_degC": round(float(estimate.nodes[2]), 2),
            "limit_degC": windings.settings.limit,
            "known": estimate.known,
        }
        for role, estimate in windings.recalled.items()
    ]
    typer.echo(json.dumps({"bench": file.name, "windings": rows}) if as_json else state_text(file.name, rows))


@app.command(epilog=examples("thermal fit runs --motor lea"))
def fit(
    runs: list[Path] = typer.Argument(
        metavar="RUN...", help="Runs or folders; those with temperatures of winding, housing and ambient are fitted."
    ),
    motor: str = typer.Option(
        "lea", help="Name of a shipped motor, or a path to a .yaml.", autocompletion=complete_motor
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Fit the thermal network and the resistance of each actuator, and state the tolerances that its runs leave."""
    from leactl.model.motor import load_motor
    from leactl.report.thermal import fit_text
    from leactl.report.thermal_fits import thermal_fits

    fits, left_out = thermal_fits(runs, load_motor(motor)[0])
    for line in left_out:
        typer.echo(f"leactl: left out: {line}", err=True)
    if as_json:
        all_fits = {"fits": [actuator_fit.as_json() for actuator_fit in fits], "left_out": left_out}
        typer.echo(json.dumps({**fits[0].as_json(), "left_out": left_out} if len(fits) == 1 else all_fits))
    else:
        typer.echo("\n\n".join(fit_text(actuator_fit) for actuator_fit in fits))


@app.command(epilog=examples("thermal plan thermal --bench emulated-heated --cold"))
def plan(
    protocol: str = typer.Argument(
        help="Name of a shipped protocol, or a path to a .yaml.", autocompletion=complete_protocol
    ),
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
    from leactl.runner.thermal_admission import Windings

    file, devices, _document = load_checked(bench)
    protocol_plan = load(protocol, read_overrides(overrides), condition)
    windings = Windings(file, devices, actuator, cold=cold)
    forecast = windings.forecast(protocol_plan)
    admitted_plan = protocol_plan
    if forecast.passing is not None:
        try:
            admitted_plan = windings.admit(protocol_plan, insert_cooldown=True)
        except InputError:
            admitted_plan = protocol_plan
    cooldowns = [row for row in admitted_plan.timeline() if row.name == "cooldown"]
    body = {
        "protocol": protocol_plan.name,
        "limit_degC": windings.settings.limit,
        "peaks_degC": {role: round(value, 2) for role, value in forecast.peaks.items()},
        "passes": None
        if forecast.passing is None
        else {
            "step": forecast.passing.step,
            "time_s": round(forecast.passing.time_s, 2),
            "role": forecast.passing.role,
        },
        "turning_from_Hz": forecast.turning_from_hz,
        "cooldowns": [{"start_s": round(row.start_s, 3), "duration_s": row.duration_s} for row in cooldowns],
    }
    typer.echo(json.dumps(body) if as_json else forecast_text(body))


@app.command(
    epilog=examples(
        "thermal commission --set current_A=9 --actuator LEA-1 --attended",
        ends=(*ON_A_BENCH, AcceptanceFailed),
        means={AcceptanceFailed: "the actuator is outside of its motor file's tolerances"},
    )
)
def commission(
    protocol: str = typer.Argument(
        "thermal", help="Name of a shipped heated protocol, or a path to a .yaml.", autocompletion=complete_protocol
    ),
    bench: str = typer.Option(
        "emulated-heated", help="Name of a shipped bench, or a path to a .yaml.", autocompletion=complete_bench
    ),
    overrides: list[str] = SET,
    actuator: str = typer.Option("", help="Label of the actuator that is commissioned; required."),
    runs: int = typer.Option(3, min=1, max=20, help="Most runs, with those of --given and the whole protocol."),
    given: list[Path] = typer.Option([], metavar="RUN", help="An earlier heated run of this actuator."),
    file: Path | None = typer.Option(None, help="The narrowed motor file. [ACTUATOR.yaml]"),
    camera_gain: float = typer.Option(
        0.02, min=0.0, max=0.2, help="Error of the camera, as a share of a temperature rise.", callback=finite
    ),
    camera_offset: float = typer.Option(
        2.0, min=0.0, max=20.0, help="Error of the camera's zero [K].", callback=finite
    ),
    current_repeats: float = typer.Option(
        0.005, min=0.0, max=0.2, help="Relative change of a supply's reading from run to run.", callback=finite
    ),
    condition: str = typer.Option("", help="Condition of the runs."),
    operator: str = typer.Option("", help="Who runs the bench."),
    out: Path = typer.Option(Path("runs"), help="Directory of the run files."),
    realtime: bool = typer.Option(False, "--realtime", help="Keep wall time on an emulated bench."),
    served: bool = typer.Option(False, "--served", help="Meet an emulated bench that another process serves."),
    bus: list[str] = typer.Option([], metavar="NAME=INTERFACE:CHANNEL", help="Put a bus elsewhere."),
    cold: bool = COLD,
    attended: bool = ATTENDED,
    trace: Path | None = TRACE,
    dry_run: bool = typer.Option(
        False, "--dry-run", help="Narrow by the runs given, say what the next one would be, and move nothing."
    ),
    as_json: bool = AS_JSON,
) -> None:
    """Heat an actuator step by step, narrow its motor file by each run, until a heated protocol is admitted and run.

    The file holds for this actuator, its mounting and the supply and camera of the runs. Name it in the bench file.
    """
    from dataclasses import replace

    from leactl.analysis.heating.narrowing import Accuracy
    from leactl.bench.wire_trace import files_of_trace
    from leactl.cli.run import perform
    from leactl.report.outputs import check_files, check_folder
    from leactl.report.thermal import commissioned_body, commissioned_text
    from leactl.runner.commission import CommissionOptions
    from leactl.runner.commission import commission as commissioned
    from leactl.runner.request import prepare
    from leactl.runner.stop_requests import signals_kept_to_the_end

    motor_file = file or Path(f"{actuator.replace('/', '-')}.yaml")
    check_files([motor_file, *(files_of_trace(trace) if trace else [])], given)
    check_folder(out)

    def request_with(changes: Mapping[str, str]) -> "Request":
        """Return the request of a run with some parameters changed."""
        unchanged = [word for word in overrides if word.partition("=")[0] not in changes]
        assignments = [*unchanged, *(f"{name}={value}" for name, value in changes.items())]
        request = prepare(protocol, bench, assignments, actuator, condition, operator, out, realtime, served, bus)
        attended_plan = replace(request.plan, attended=attended or request.plan.attended)
        return replace(request, plan=attended_plan, trace=wire_trace)

    accuracy = Accuracy(camera_gain, camera_offset, current_repeats)
    options = CommissionOptions(request_with, perform, _tell, runs, given, accuracy, cold, dry_run)
    with traced_to(None if dry_run else trace) as wire_trace, signals_kept_to_the_end():
        commissioning = commissioned(options, motor_file)
    body = commissioned_body(commissioning, protocol, actuator)
    typer.echo(json.dumps(body) if as_json else commissioned_text(body))


def _tell(text: str) -> None:
    """Print a message on stderr."""
    typer.echo(f"leactl: {text}", err=True)
