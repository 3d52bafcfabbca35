"""The plan of a protocol as text and as JSON: timeline, peaks and searches; and what a run of the plan would do now."""

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from leactl.quantities import UNITS
from leactl.report.terminal import duration

if TYPE_CHECKING:
    from leactl.protocol.plan import Plan
    from leactl.runner.dry_run import DryRun
    from leactl.runner.request import Request
    from leactl.safety.limits import Limits
    from leactl.safety.thermal.foresight import Forecast


def plan_lines(plan: "Plan", limits: "Limits | None" = None) -> list[str]:
    """Return the lines of a plan: timeline, duration, and peak setpoints, with the limits of a bench if given."""
    lines = [f"{plan.name}: {plan.title}".rstrip(": ")]
    lines += [f"  {name} = {value}" for name, value in plan.parameters.items()]
    lines.append(f"{'start/s':>10} {'last/s':>9} {'settle/s':>9}  {'step':<10}  setpoints")
    for row in plan.timeline():
        times = f"{row.start_s:10.3f} {row.duration_s:9.3f} {row.settle_s:9.3f}"
        lines.append(f"{times}  {row.name:<10}  {row.setpoints}".rstrip())
    bound_prefix = "at most " if plan.adaptive else ""
    lines.append(f"duration {bound_prefix}{duration(plan.duration_s, always_hours=True)} ({plan.duration_s:.3f} s)")
    for peak in peaks(plan, limits):
        low, high = peak.get("limits") or (-math.inf, math.inf)
        limits_text = f", limits {low:g} to {high:g} {peak['unit']}" if math.isfinite(high - low) else ""
        lines.append(f"peak {peak['role']} {peak['quantity']} {peak['value']:g} {peak['unit']}{limits_text}")
    return [*lines, *searches(plan)]


def head(plan: "Plan") -> dict[str, Any]:
    """Return name, set-up, rates, condition, duration and parameters of a protocol as JSON takes them."""
    keys = ("name", "title", "setup", "analysis", "rate_Hz", "record_Hz", "condition", "duration_s")
    return {**{key: getattr(plan, key) for key in keys}, "parameters": dict(plan.parameters)}


def searches(plan: "Plan") -> list[str]:
    """Return a line for each search: its trials, its bounds, and how long it takes at most."""
    lines = [f"bisect {search.name}: {search}, {seconds:g} s of trials at most" for search, seconds in plan.searches()]
    return [f"{text}{f', {lines.count(text)} times' * (lines.count(text) > 1)}" for text in dict.fromkeys(lines)]


def peaks(plan: "Plan", limits: "Limits | None" = None) -> list[dict[str, Any]]:
    """Return the largest setpoint of each role and quantity with its unit, and with the limits of a bench if given."""
    return [
        {"role": role, "quantity": quantity, "value": value, "unit": UNITS[quantity]}
        | ({} if limits is None else {"limits": limits.of(quantity)})
        for (role, quantity), value in plan.peaks().items()
    ]


def hottest(forecast: "Forecast") -> dict[str, float]:
    """Return the highest possible temperature [degC] of the winding of each role."""
    return {role: round(value, 2) for role, value in forecast.peaks.items()}


def dry_run_body(request: "Request", dry_run: "DryRun") -> dict[str, Any]:
    """Return what a run would do now as JSON takes it: file, peaks, winding temperatures, timeline, warnings."""
    from leactl.runfile.write.run_info import new_run_id

    plan, windings = dry_run.plan, dry_run.windings
    return {
        **head(plan),
        "bench": request.bench.name,
        "devices": [
            {"name": device.name, "driver": device.entry.driver, "role": device.entry.role}
            for device in request.devices
        ],
        "actuator": request.actuator,
        "run": str(request.directory / f"{new_run_id(plan.name, datetime.now(UTC))}.h5"),
        "planned_bytes": round(dry_run.planned_bytes),
        "peaks": peaks(plan, request.bench.limits),
        "windings": {
            role: {
                "begins_degC": round(float(windings.recalled[role].nodes[0]), 2),
                "known": windings.recalled[role].known,
                "hottest_degC": peak,
                "limit_degC": windings.settings.limit,
            }
            for role, peak in hottest(dry_run.forecast).items()
        },
        "left_on": list(dry_run.left_on),
        "tripped": False,
        "held": False,
        "searches": searches(plan),
        "timeline": [row._asdict() for row in plan.timeline()],
        "one_sensor": list(dry_run.one_sensor),
        "warnings": list(dry_run.warnings),
    }


def dry_run_text(request: "Request", dry_run: "DryRun", body: Mapping[str, Any]) -> str:
    """Return what a run would do now as text.

    Parameters
    ----------
    body : the document that `--json` prints.
    """
    lines = plan_lines(dry_run.plan, request.bench.limits)
    for role, winding in body["windings"].items():
        peak, limit = winding["hottest_degC"], winding["limit_degC"]
        lines.append(f"winding {role} at most {peak:g} degC, limit {limit:g} degC; {winding['known']}")
    lines += [*body["left_on"], *body["one_sensor"]]
    lines.append(f"would open {', '.join(device['name'] for device in body['devices'])}")
    lines.append(f"bench '{body['bench']}' is not tripped, and no other run holds it")
    lines.append(f"would write {body['planned_bytes'] / 1e6:.1f} MB at most, as {body['run']}")
    return "\n".join(lines)
