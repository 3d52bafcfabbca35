"""Thermal limits, fits, states, forecasts and commissionings of windings as text that fits 80 columns."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from leactl.model.motor import Motor
from leactl.report.terminal import TEXT_WIDTH, wrapped
from leactl.report.thermal_fits import ActuatorFit
from leactl.safety.thermal.guarded_currents import Carried, ContinuousLimits, Peak

if TYPE_CHECKING:
    from leactl.runner.commission import Commissioned

MOST_CORRELATIONS = 3  # that a fit shows: the largest
LIMITS_HEADING = f"{'':<28}{'guaranteed':>12}{'nominal':>12}{'favourable':>12}"


def limits_text(motor: Motor, ambient: float, continuous: Sequence[ContinuousLimits], peaks: Sequence[Peak]) -> str:
    """Return a table of continuous and peak currents [A] and torques [N*m] of one motor at an ambient [degC]."""
    lines = [
        f"{motor.name}: hottest phase at {motor.limits.winding_temperature:g} degC, ambient {ambient:g} degC",
        "guaranteed: by every actuator inside the motor file's tolerances",
        "",
        LIMITS_HEADING,
    ]
    for motion_limits in continuous:
        lines.append(_limits_row(f"continuous, {motion_limits.motion} [A]", motion_limits.current))
        lines.append(_limits_row("    [N*m]", motion_limits.torque))
    for peak in peaks:
        lines.append(_limits_row(f"{peak.duration_s:g} s at standstill [A]", peak.current))
        lines.append(_limits_row("    [N*m]", peak.torque))
    return "\n".join(lines)


def _limits_row(label: str, values: Carried) -> str:
    """Return one row under LIMITS_HEADING: guaranteed, nominal and favourable value."""
    return f"{label:<28}{values.guaranteed:12.2f}{values.nominal:12.2f}{values.favourable:12.2f}"


def fit_text(actuator_fit: ActuatorFit) -> str:
    """Return fitted parameters with standard errors, their largest correlations, a `tolerances:` block and notes."""
    fit, runs = actuator_fit.fit, actuator_fit.runs
    title = f"{actuator_fit.actuator or 'actuator not named'}, {len(runs)} run{'s' * (len(runs) > 1)}:"
    lines = [wrapped(title, runs, TEXT_WIDTH)]
    lines += [f"{'parameter':<36}{'nominal':>11}{'fitted':>11}{'std':>10}  unit"]
    lines += [
        f"{row.parameter:<36}{row.nominal:11.5g}{row.fitted:11.5g}{row.std:10.2g}  {row.units}"
        for row in fit.parameters
    ]
    count = len(fit.parameters)
    pairs = [(abs(fit.correlation[i, k]), i, k) for i in range(count) for k in range(i)]
    for _, i, k in sorted(pairs, reverse=True)[:MOST_CORRELATIONS]:
        first, second = (fit.parameters[index].parameter.removeprefix("thermal.") for index in (k, i))
        lines.append(f"  correlation {fit.correlation[i, k]:+.2f} of {first} and {second}")
    lines += ["tolerances:  # of the motor file, three standard errors; others as they were"]
    lines += [f"  {name}: {value:g}" for name, value in fit.tolerances.items()]
    lines += [wrapped("note:", [note], TEXT_WIDTH) for note in actuator_fit.notes]
    return "\n".join(lines)


def state_text(bench: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return upper bounds of the temperatures [degC] of each winding of a bench, and how they are known.

    Parameters
    ----------
    rows : one for each role, as `leactl thermal state --json` prints them.
    """
    lines = [f"{bench}: at most, in degC", f"{'role':<6}{'phase':>8}{'winding':>9}{'housing':>9}{'limit':>7}  known by"]
    for row in rows:
        numbers = f"{row['hottest_phase_degC']:8.1f}{row['winding_degC']:9.1f}{row['housing_degC']:9.1f}"
        lines.append(f"{row['role']:<6}{numbers}{row['limit_degC']:7.0f}  {row['actuator']}: {row['known']}")
    return "\n".join(lines)


def forecast_text(body: Mapping[str, Any]) -> str:
    """Return the peak temperatures [degC] of a protocol, and the waits that would keep it below the limit.

    Parameters
    ----------
    body : the document that `leactl thermal plan --json` prints.
    """
    lines = [f"{body['protocol']}: hottest phases at most, limit {body['limit_degC']:g} degC"]
    lines += [f"  {role:<6}{value:8.1f} degC" for role, value in body["peaks_degC"].items()]
    if (rate_hz := body["turning_from_Hz"]) is not None:
        lines.append(f"  rate_Hz is below about {rate_hz:g}: over a tenth of a turning rotor's heat counts as standing")
    limit_crossing = body["passes"]
    if limit_crossing is None:
        lines.append("may be run as it is")
        return "\n".join(lines)
    step, time_s = limit_crossing["step"], limit_crossing["time_s"]
    lines.append(f"the {limit_crossing['role']} winding may pass it in step '{step}', after {time_s:g} s")
    for wait in body["cooldowns"]:
        lines.append(f"  a wait of {wait['duration_s']:g} s at {wait['start_s']:g} s helps (--insert-cooldown)")
    if not body["cooldowns"]:
        lines.append("  no wait between its steps helps: shorten or lower them")
    return "\n".join(lines)


def commissioned_body(commissioned: "Commissioned", protocol: str, actuator: str) -> dict[str, Any]:
    """Return the progress of a commissioning as JSON takes it; temperatures are upper bounds [degC].

    Parameters
    ----------
    protocol : name of the heated protocol that is to be admitted.
    actuator : label of the actuator.
    """
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
    """Return the runs that heated the actuator, the tolerances that its motor file has now, and the next step.

    Parameters
    ----------
    body : as `commissioned_body` returns it.
    """
    progress = "run" if body["done"] else "admitted" if body["admitted"] else "not admitted yet"
    lines = [f"{body['actuator']}: protocol '{body['protocol']}' {progress}"]
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
