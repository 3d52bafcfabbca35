"""Acceptance limits of a protocol, judged on the analysis of the run that has just been made."""

from pathlib import Path
from typing import Any

from leactl.protocol.plan import Plan


def judge(plan: Plan, run: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """Every limit with the value found, and one line for each that is not met; a value that is missing is not met."""
    from leactl.analysis.experiments import analyze_runs

    result = analyze_runs([run])
    rows, unmet = [], []
    for limit in plan.acceptance:
        value = result.find(limit.result).value
        met = limit.low <= value <= limit.high
        rows.append({"result": limit.result, "value": value, "units": limit.unit, "met": met})
        if not met:
            bounds = f"{limit.low:g} to {limit.high:g}"
            unmet.append(f"acceptance: {limit.result} is {value:.6g} {limit.unit}, {bounds} was required")
    return rows, unmet
