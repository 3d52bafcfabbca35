"""Campaigns in the terminal: the plan of a campaign, and the state of its runs."""

from collections.abc import Mapping
from typing import Any

from leactl.report.plan import hottest, peaks
from leactl.report.terminal import duration
from leactl.runner.dry_run import Preview


def demands(preview: Preview) -> dict[str, Any]:
    """Return duration, largest setpoints and winding temperatures of a run that starts at ambient, as a JSON object."""
    return {
        "duration_s": round(preview.duration_s, 3),
        "peaks": peaks(preview.plan),
        "hottest_degC": hottest(preview.forecast),
    }


def plan_text(title: str, body: Mapping[str, Any]) -> str:
    """Return a line for each run with its demands, a line before each change of the mounted parts, and the total time.

    Parameters
    ----------
    body : the document that `--json` prints.
    """
    rows = body["runs"]
    lines = [f"{body['campaign']}: {title}".rstrip(": ")]
    column_texts = [_columns(row) for row in rows]
    widths = [max(map(len, column)) for column in zip(*column_texts, strict=True)]
    last_prompt = ""
    for number, row in enumerate(rows, start=1):
        if row["prompt"] and row["prompt"] != last_prompt:
            lines.append(f"      mount {row['prompt']}")
        last_prompt = row["prompt"]
        columns = "  ".join(f"{text:<{width}}" for text, width in zip(column_texts[number - 1], widths, strict=True))
        details = "  ".join(filter(None, (row["actuator"], row["condition"], f"repeat {row['repeat']}")))
        finished_mark = "  finished" if row["finished"] else ""
        lines.append(f"{number:>5}  {duration(row['duration_s']):>8}  {columns}  {details}{finished_mark}")
    remaining_s = sum(row["duration_s"] for row in rows if not row["finished"])
    remaining_count = sum(not row["finished"] for row in rows)
    lines.append(
        f"{remaining_count} of {len(rows)} runs are left, {duration(remaining_s)} of bench time, in {body['folder']}"
    )
    return "\n".join(lines)


def _columns(row: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return three texts on a run: step, and protocol if that has another name; largest setpoints; windings."""
    step, protocol = row["step"], row["protocol"]
    setpoint_texts = ", ".join(f"{peak['role']} {peak['value']:.4g} {peak['unit']}" for peak in row["peaks"])
    winding_texts = ", ".join(f"{role} {value:.0f}" for role, value in row["hottest_degC"].items())
    name = step if step == protocol else f"{step} ({protocol})"
    return name, setpoint_texts or "no setpoint", f"windings {winding_texts} degC at most"


def campaign_state_text(body: Mapping[str, Any]) -> str:
    """Return a line for each run of a campaign with its file or state, and a line for each problem.

    Parameters
    ----------
    body : the document that `--json` prints.
    """
    rows = body["runs"]
    width = max(len(row["run"]) for row in rows)
    lines = []
    for row in rows:
        state = row["file"] or ("lost" if row["run"] in body["lost"] else "left")
        lines.append(f"{row['run']:<{width}}  {state}")
        lines += [f"  {text}" for text in row["unmet"]]
    lines += [f"{key}: {fate}" for key, fate in body["lost"].items()]
    lines += [f"{key}: finished, and changed since" for key in body["changed"]]
    lines += [f"cut off: {path}" for path in body["unfinished"]]
    under_way = ", under way" if body["under_way"] else ""
    lines.append(f"{body['finished']} of {len(rows)} runs are finished in {body['folder']}{under_way}")
    return "\n".join(lines)
