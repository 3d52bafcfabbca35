"""Acceptance limits of a protocol: refused before a run that nothing could judge, and judged on the run's analysis."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from leactl import yamlfile
from leactl.errors import InputError
from leactl.protocol.plan import Acceptance, Plan
from leactl.protocol.protocolfile import locate
from leactl.units import CONVERSIONS, SECONDS

if TYPE_CHECKING:
    from leactl.analysis.estimate import Result


def check_analysis(plan: Plan, protocol: str) -> None:
    """Refuse an analysis that is not known, and limits that no analysis would judge.

    Which results an analysis gives is up to the run too, so that those of the limits are looked for after it.

    Parameters
    ----------
    protocol : name or path that the plan was loaded from.

    Raises
    ------
    InputError : one line with file, line and column.
    """
    from leactl.analysis.experiments import asked_in, is_known, names

    asked = asked_in(plan.text)
    if not (asked or plan.acceptance) or is_known(asked or plan.name):
        return
    document = yamlfile.parse(plan.text, str(locate(protocol)))
    known = f"known: {', '.join(names())}"
    if asked:
        raise InputError(document.fault(("analysis",), f"'{asked}' is not known; {known}"))
    raise InputError(document.fault(("acceptance",), f"the protocol names no analysis to judge them by; {known}"))


def judge(plan: Plan, run: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """Every limit with the value found, and one line for each that is not met; a value that is missing is not met."""
    from leactl.analysis.experiments import analyze_runs

    answer: Result | InputError
    try:
        answer = analyze_runs([run])
    except InputError as fault:  # the run stands; it does not answer
        answer = fault
    judged = [_judged(limit, answer) for limit in plan.acceptance]
    return [row for row, _line in judged], [f"acceptance: {line}" for _row, line in judged if line]


def _judged(limit: Acceptance, answer: "Result | InputError") -> tuple[dict[str, Any], str]:
    """A limit's row, in its own unit where the result can be told in it, and what is wrong."""
    row: dict[str, Any] = {"result": limit.result, "value": None, "units": limit.unit, "met": False}
    bounds = f"{limit.low:g} to {limit.high:g} was required"
    try:
        if isinstance(answer, InputError):
            raise answer
        found = answer.find(limit.result)
    except InputError as fault:
        return row, f"{limit.result} is not known, {bounds}: {fault}"
    factor = _factor(found.units, limit.unit)
    value, units = (found.value, found.units) if factor is None else (found.value * factor, limit.unit)
    row |= {"value": value if math.isfinite(value) else None, "units": units}
    told = f"{limit.result} is {value:.6g} {units}"
    if factor is None:
        return row, f"{told}, its limit is in {limit.unit}; write the limit in {units}"
    row["met"] = limit.low <= value <= limit.high
    return row, "" if row["met"] else f"{told}, {bounds}"


def _factor(units: str, wanted: str) -> float | None:
    """By what numbers in these units become numbers in the wanted one; None where they measure something else.

    Units with another zero count as something else: a result in K is a rise, which is no temperature in degC.
    """
    if units == wanted:
        return 1.0
    for table in (*CONVERSIONS.values(), {unit: (scale, 0.0) for unit, scale in SECONDS.items()}):
        if units in table and wanted in table:
            (own, own_zero), (other, other_zero) = table[units], table[wanted]
            return own / other if own_zero == other_zero else None
    return None
