"""Thermal limits, state and forecasts as text that fits 80 columns."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from leactl.model.motor import Motor
from leactl.report.terminal import TEXT_WIDTH, wrapped
from leactl.report.thermal_fits import ActuatorFit
from leactl.safety.thermal.capability import Carried, ContinuousLimits, Peak

if TYPE_CHECKING:
    from leactl.runner.commission import Commissioned

MOST_CORRELATIONS = 3  # the largest are shown
HEAD = f"{'':<28}{'guaranteed':>12}{'nominal':>12}{'favourable':>12}"


def limits_text(motor: Motor, ambient: float, continuous: Sequence[ContinuousLimits], peaks: Sequence[Peak]) -> str:
    """Return the continuous and peak currents [A] and torques [N*m] of one motor."""
    lines = [
        f"{motor.name}: hottest phase at {motor.limits.winding_temperature:g} degC, ambient {ambient:g} degC",
        "guaranteed: by every actuator inside the motor file's tolerances",
        "",
        HEAD,
    ]
    for state in continuous:
        lines += [_row(f"continuous, {state.motion} [A]", state.current), _row("    [N*m]", state.torque)]
    for peak in peaks:
        lines += [_row(f"{peak.duration_s:g} s at standstill [A]", peak.current), _row("    [N*m]", peak.torque)]
    return "\n".join(lines)


def _row(label: str, values: Carried) -> str:
    return f"{label:<28}{values.guaranteed:12.2f}{values.nominal:12.2f}{values.favourable:12.2f}"


def fit_text(fitted: ActuatorFit) -> str:
    """Return fitted parameters with standard errors, their largest correlations, a `tolerances:` block and notes."""
    fit = fitted.fit
    lines = [
        wrapped(
            f"{fitted.actuator or 'actuator not told'}, {len(fitted.runs)} run{'s' * (len(fitted.runs) > 1)}:",
            fitted.runs,
            TEXT_WIDTH,
        ),
    ]
    lines += [f"{'parameter':<36}{'nominal':>11}{'fitted':>11}{'std':>10}  unit"]
    lines += [
        f"{row.parameter:<36}{row.nominal:11.5g}{row.fitted:11.5g}{row.std:10.2g}  {row.units}"
        for row in fit.parameters
    ]
    size = len(fit.parameters)
    pairs = [(abs(fit.correlation[i, k]), i, k) for i in range(size) for k in range(i)]
    for _, i, k in sorted(pairs, reverse=True)[:MOST_CORRELATIONS]:
        first, second = (fit.parameters[n].parameter.removeprefix("thermal.") for n in (k, i))
        lines.append(f"  correlation {fit.correlation[i, k]:+.2f} of {first} and {second}")
    lines += ["tolerances:  # of the motor file, three standard errors; others as they were"]
    lines += [f"  {name}: {value:g}" for name, value in fit.tolerances.items()]
    lines += [wrapped("note:", [note], TEXT_WIDTH) for note in fitted.notes]
    return "\n".join(lines)


def state_text(bench: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return an upper bound of each winding's temperature [degC]."""
    lines = [f"{bench}: at most, in degC", f"{'role':<6}{'phase':>8}{'winding':>9}{'housing':>9}{'limit':>7}  known by"]
    for row in rows:
        numbers = f"{row['hottest_phase_degC']:8.1f}{row['winding_degC']:9.1f}{row['housing_degC']:9.1f}"
        lines.append(f"{row['role']:<6}{numbers}{row['limit_degC']:7.0f}  {row['actuator']}: {row['known']}")
    return "\n".join(lines)


def forecast_text(body: Mapping[str, Any]) -> str:
    """Return the peak temperatures [degC] of a plan, and the waits that would keep it below the limit."""
    lines = [f"{body['protocol']}: hottest phases at most, limit {body['limit_degC']:g} degC"]
    lines += [f"  {role:<6}{value:8.1f} degC" for role, value in body["peaks_degC"].items()]
    if (least := body["turning_from_Hz"]) is not None:
        lines.append(f"  rate_Hz is below about {least:g}: over a tenth of a turning rotor's heat counts as standing")
    passes = body["passes"]
    if passes is None:
        lines.append("may be run as it is")
        return "\n".join(lines)
    lines.append(f"the {passes['role']} winding may pass it in step '{passes['step']}', after {passes['time_s']:g} s")
    for wait in body["cooldowns"]:
        lines.append(f"  a wait of {wait['duration_s']:g} s at {wait['start_s']:g} s helps (--insert-cooldown)")
    if not body["cooldowns"]:
        lines.append("  no wait between its steps helps: shorten or lower them")
    return "\n".join(lines)


def commissioned_body(commissioned: "Commissioned", protocol: str, actuator: str) -> dict[str, Any]:
    """Return how far the commissioning of an actuator came, as JSON takes it; temperatures are upper bounds [degC]."""
    tolerances = commissioned.motor.tolerances
    passing = commissioned.forecast.passing
    return {
        "protocol": protocol,
        "actuator": actuator,
        "admitted": commissioned.admitted,
        "done": any(heat.whole for heat in commissioned.heats),
        "peak_degC": round(commissioned.forecast.peaks["test"], 2),
        "limit_degC": round(commissioned.limit, 2),
        "passes_after_s": None if passing is None else round(passing.time_s, 2),
        "runs": [
            {"run": str(heat.path), "heating_s": heat.heating_s, "whole": heat.whole} for heat in commissioned.heats
        ],
        "next_heating_s": commissioned.next_heating_s,
        "motor_file": None if commissioned.file is None else str(commissioned.file),
        "load_motor": commissioned.load_motor,
        "tolerances": {} if tolerances is None else tolerances.model_dump(exclude_none=True),
    }


def commissioned_text(body: Mapping[str, Any]) -> str:
    """Return the runs that heated the actuator, the tolerances that its motor file has now, and the next step."""
    state = "run" if body["done"] else "admitted" if body["admitted"] else "not admitted yet"
    lines = [f"{body['actuator']}: protocol '{body['protocol']}' {state}"]
    lines += [f"  {run['heating_s']:6.0f} s of heating  {run['run']}" for run in body["runs"]]
    if body["next_heating_s"] is not None:
        lines += [f"  {body['next_heating_s']:6.0f} s of heating come next"]
    lines += [f"  bound {body['peak_degC']:.1f} degC, limit {body['limit_degC']:.1f} degC"]
    if body["motor_file"] is None:
        return "\n".join([*lines, "by the bench's own motor file"])
    lines += [f"tolerances in {body['motor_file']}:"]
    lines += [f"  {name}: {value:g}" for name, value in body["tolerances"].items()]
    instruction = f"name it in the bench file: motors: {{test: {body['motor_file']}, load: {body['load_motor']}}}"
    return "\n".join([*lines, instruction])
