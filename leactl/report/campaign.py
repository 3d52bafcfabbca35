"""Campaigns in the terminal: the plan before it begins, and how far it is."""

from collections.abc import Mapping
from typing import Any

from leactl.report.terminal import duration


def plan_text(title: str, body: Mapping[str, Any]) -> str:
    """Every run in its order with what it needs, prompts where something has to be mounted, and the time in all.

    Parameters
    ----------
    body : as `--json` prints it.
    """
    rows = body["runs"]
    lines = [f"{body['campaign']}: {title}".rstrip(": ")]
    width = max(len(row["step"]) for row in rows)
    prompted = ""
    for number, row in enumerate(rows, start=1):
        if row["prompt"] and row["prompt"] != prompted:
            lines.append(f"      mount {row['prompt']}")
        prompted = row["prompt"]
        details = "  ".join(filter(None, (row["actuator"], row["condition"], f"repeat {row['repeat']}")))
        done = "  finished" if row["finished"] else ""
        lines.append(f"{number:>5}  {row['step']:<{width}}  {duration(row['duration_s']):>8}  {details}{done}")
    remaining_s = sum(row["duration_s"] for row in rows if not row["finished"])
    count = sum(not row["finished"] for row in rows)
    lines.append(f"{count} of {len(rows)} runs are left, {duration(remaining_s)} of bench time, in {body['folder']}")
    return "\n".join(lines)


def campaign_state_text(body: Mapping[str, Any]) -> str:
    """How far a campaign is, a line for each run and for everything that is wrong.

    Parameters
    ----------
    body : as `--json` prints it.
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
