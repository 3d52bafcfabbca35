"""Acceptance limits of a protocol: checked before a run, and judged on the analysis of the run."""

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


def check_analysis(plan: Plan, file_name: str) -> None:
    """Raise InputError for an unknown analysis, and for limits on results that it lacks or gives in other units.

    Parameters
    ----------
    file_name : name of the protocol's file, for messages.

    Raises
    ------
    InputError : one line for each fault, with file, line and column.
    """
    from leactl.analysis.analyze import is_known, names, results_of
    from leactl.runfile.catalog.summaries import analysis_in

    named_analysis = analysis_in(plan.text)
    limits = {number: limit for number, limit in enumerate(plan.acceptance) if isinstance(limit, Acceptance)}
    if not (named_analysis or limits):
        return
    document = yamlfile.parse(plan.text, file_name)
    if not is_known(named_analysis or plan.name):
        known = f"known: {', '.join(names())}"
        if named_analysis:
            raise InputError(document.fault(("analysis",), f"'{named_analysis}' is not known; {known}"))
        message = f"the protocol names no analysis to judge them by; {known}; limits on channels need none"
        raise InputError(document.fault(("acceptance",), message))
    results = results_of(named_analysis or plan.name)
    misfits = {
        number: misfit
        for number, limit in limits.items()
        if (misfit := _misfit(limit, named_analysis or plan.name, results)) is not None
    }
    faults = [document.fault(("acceptance", number, key), message) for number, (key, message) in misfits.items()]
    if faults:
        raise InputError(faults)


def _misfit(limit: Acceptance, experiment: str, results: Mapping[str, str]) -> tuple[str, str] | None:
    """Return the key of a limit that does not fit the experiment's results, and why; None if it fits."""
    units = results.get(limit.result)
    if units is None:
        close_matches = get_close_matches(limit.result, results, n=1)
        expected = close_matches[0] if close_matches else f"one of {', '.join(results)}"
        return "result", f"{experiment} has no result '{limit.result}'; {expected} was expected"
    if _factor(units, limit.unit) is None:
        return "unit", f"{limit.unit!r}: {limit.result} is in {units}"
    return None


def judge_outcome(plan: Plan, outcome: "Outcome") -> tuple[list[dict[str, Any]], list[str]]:
    """Return a row for every limit of a run, and a line for each unmet limit.

    If the run failed, the rows are those of limits on channels and searches, and there are no lines.
    """
    rows: list[dict[str, Any]] = [dict(verdict.row) for verdict in outcome.verdicts]
    if outcome.error is not None or not plan.acceptance:
        return rows, []
    judged_rows, unmet = judge_run_file(plan, outcome.path)
    return rows + judged_rows, unmet


def judge_run_file(plan: Plan, run: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """Return a row for every limit on a result, and a line for each unmet limit, also on channels and searches.

    A result without a value does not meet its limit. Verdicts on channels and searches are read from the run's events.
    """
    from leactl.analysis.analyze import analyze_runs

    limits = [limit for limit in plan.acceptance if isinstance(limit, Acceptance)]
    unmet = []
    if len(limits) < len(plan.acceptance):
        with Run.open(run) as opened_run:
            events = [event for event in opened_run.events if (event.source, event.level) == (ACCEPTANCE, "warning")]
        unmet = [f"acceptance: {event.message}" for event in events]
    if not limits:
        return [], unmet
    result: Result | InputError
    try:
        result = analyze_runs([run])
    except InputError as fault:  # the run is recorded, but its analysis fails
        result = fault
    judgements = [_judgement(limit, result) for limit in limits]
    return [row for row, _line in judgements], [*unmet, *(f"acceptance: {line}" for _row, line in judgements if line)]


def _judgement(limit: Acceptance, analysis: "Result | InputError") -> tuple[dict[str, Any], str]:
    """Return the row of a limit, in the unit of the limit if possible, and why it is unmet, or an empty string."""
    row: dict[str, Any] = {"result": limit.result, "value": None, "units": limit.unit, "met": False}
    bounds = f"{limit.low:g} to {limit.high:g} was required"
    try:
        if isinstance(analysis, InputError):
            raise analysis
        result = analysis.find(limit.result)
    except InputError as fault:
        return row, f"{limit.result} is not known, {bounds}: {fault}"
    factor = _factor(result.units, limit.unit)
    value, units = (result.value, result.units) if factor is None else (result.value * factor, limit.unit)
    row |= {"value": value if math.isfinite(value) else None, "units": units}
    summary = f"{limit.result} is {value:.6g} {units}"
    if factor is None:
        return row, f"{summary}, its limit is in {limit.unit}; write the limit in {units}"
    row["met"] = limit.low <= value <= limit.high
    return row, "" if row["met"] else f"{summary}, {bounds}"


def _factor(units: str, wanted_units: str) -> float | None:
    """Return the factor from these units to the wanted units; None if the two measure different quantities.

    Units with another zero count as a different quantity: a result in K is a rise, not a temperature in degC.
    """
    if units == wanted_units:
        return 1.0
    for table in (*CONVERSIONS.values(), {unit: (scale, 0.0) for unit, scale in SECONDS.items()}):
        if units in table and wanted_units in table:
            (scale, zero), (wanted_scale, wanted_zero) = table[units], table[wanted_units]
            return scale / wanted_scale if zero == wanted_zero else None
    return None
