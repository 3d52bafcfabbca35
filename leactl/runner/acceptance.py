"""Acceptance limits of a protocol, judged on the analysis of the run that has just been made."""

import math
from pathlib import Path
from typing import Any

from leactl.errors import InputError
from leactl.protocol.plan import Plan


def judge(plan: Plan, run: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """Every limit with the value found, and one line for each that is not met; a value that is missing is not met."""
    from leactl.analysis.experiments import analyze_runs

    rows, unmet = [], []
    for limit in plan.acceptance:
        row: dict[str, Any] = {"result": limit.result, "value": None, "units": limit.unit, "met": False}
        bounds = f"{limit.low:g} to {limit.high:g} was required"
        try:
            found = analyze_runs([run]).find(limit.result).value
        except InputError as fault:  # the run stands; it does not answer
            unmet.append(f"acceptance: {limit.result} is not known, {bounds}: {fault}")
        else:
            row |= {"value": found if math.isfinite(found) else None, "met": limit.low <= found <= limit.high}
            if not row["met"]:
                unmet.append(f"acceptance: {limit.result} is {found:.6g} {limit.unit}, {bounds}")
        rows.append(row)
    return rows, unmet
