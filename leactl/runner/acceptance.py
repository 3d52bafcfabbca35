"""Acceptance limits of a protocol: refused before a run that nothing could judge, and judged on the run's analysis."""

import math
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

from leactl import yamlfile
from leactl.errors import InputError
from leactl.protocol.plan import Acceptance, Plan
from leactl.runfile.read.reader import Run
from leactl.runner.channel_limits import ACCEPTANCE
from leactl.units import CONVERSIONS, SECONDS

if TYPE_CHECKING:
    from leactl.analysis.estimate import Result
    from leactl.runner.outcome import Outcome


def check_analysis(plan: Plan, name: str) -> None:
    """Refuse an analysis that is not known, and limits on results that it does not have or not in this unit.

    Parameters
    ----------
    name : of the protocol's file, for messages.

    Raises
    ------
    InputError : one line a fault with file, line and column.
    """
    from leactl.analysis.analyze import is_known, names, results_of
    from leactl.runfile.catalog.summaries import analysis_in

    asked = analysis_in(plan.text)
    limits = {n: limit for n, limit in enumerate(plan.acceptance) if isinstance(limit, Acceptance)}
    if not (asked or limits):
        return
    document = yamlfile.parse(plan.text, name)
    if not is_known(asked or plan.name):
        known = f"known: {', '.join(names())}"
        if asked:
            raise InputError(document.fault(("analysis",), f"'{asked}' is not known; {known}"))
        message = f"the protocol names no analysis to judge them by; {known}; limits on channels need none"
        raise InputError(document.fault(("acceptance",), message))
    results = results_of(asked or plan.name)
    misfits = {n: _misfit(limit, asked or plan.name, results) for n, limit in limits.items()}
    faults = [document.fault(("acceptance", n, fault[0]), fault[1]) for n, fault in misfits.items() if fault]
    if faults:
        raise InputError(faults)


def _misfit(limit: Acceptance, experiment: str, results: Mapping[str, str]) -> tuple[str, str] | None:
    """The key of a limit that the experiment's results do not fit, and why."""
    units = results.get(limit.result)
    if units is None:
        close = get_close_matches(limit.result, results, n=1)
        expected = close[0] if close else f"one of {', '.join(results)}"
        return "result", f"{experiment} has no result '{limit.result}'; {expected} was expected"
    if _factor(units, limit.unit) is None:
        return "unit", f"{limit.unit!r}: {limit.result} is in {units}"
    return None


def judge_all(plan: Plan, outcome: "Outcome") -> tuple[list[dict[str, Any]], list[str]]:
    """Every limit of a run that has ended, and one line for each that is not met; of one that failed, those judged."""
    rows: list[dict[str, Any]] = [dict(verdict.row) for verdict in outcome.verdicts]
    if outcome.error is not None or not plan.acceptance:
        return rows, []
    judged, unmet = judge(plan, outcome.path)
    return rows + judged, unmet


def judge(plan: Plan, run: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """Every limit on a result with its value, and one line for each limit, of channels too, that is not met.

    A value that is missing is not met. How the channels did stands in the run's events.
    """
    from leactl.analysis.analyze import analyze_runs

    limits = [limit for limit in plan.acceptance if isinstance(limit, Acceptance)]
    unmet = []
    if len(limits) < len(plan.acceptance):
        with Run.open(run) as opened:
            events = [event for event in opened.events if (event.source, event.level) == (ACCEPTANCE, "warning")]
        unmet = [f"acceptance: {event.message}" for event in events]
    if not limits:
        return [], unmet
    answer: Result | InputError
    try:
        answer = analyze_runs([run])
    except InputError as fault:  # the run stands; it does not answer
        answer = fault
    judged = [_judged(limit, answer) for limit in limits]
    return [row for row, _line in judged], [*unmet, *(f"acceptance: {line}" for _row, line in judged if line)]


def _judged(limit: Acceptance, answer: "Result | InputError") -> tuple[dict[str, Any], str]:
    """A limit's row, in its own unit where the result can be told in it, and what is wrong."""
    row: dict[str, Any] = {"result": limit.result, "value": None, "units": limit.unit, "met": False}
    bounds = f"{limit.low:g} to {limit.high:g} was required"
    try:
        if isinstance(answer, InputError):
            raise answer
        result = answer.find(limit.result)
    except InputError as fault:
        return row, f"{limit.result} is not known, {bounds}: {fault}"
    factor = _factor(result.units, limit.unit)
    value, units = (result.value, result.units) if factor is None else (result.value * factor, limit.unit)
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
