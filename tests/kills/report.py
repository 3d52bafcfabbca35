"""What many trials gave, as a page: counts, and when the slower drive was without torque after its last heartbeat."""

import statistics

from tests.kills.strikes import STRIKES, expected
from tests.kills.trial import MARGIN_S


def report(found: list[dict], consumer_s: float) -> str:
    """Markdown of all trials."""
    struck = [item for item in found if "void" not in item]
    bad = [item for item in struck if item["faults"]]
    loads = [item["load"] for item in found]
    lost = [item["lost_s"] for item in struck if "lost_s" in item]
    lines = [
        f"{len(struck) - len(bad)} of {len(struck)} struck runs ended as they must. Consumer time"
        f" {consumer_s * 1e3:g} ms; {(consumer_s + MARGIN_S) * 1e3:g} ms are allowed from the last heartbeat that the"
        " drive heard to a drive without torque, by the bench's own clock.",
        "",
        "| struck by | ends | runs | ended as they must | median, ms | 95 %, ms | worst, ms |",
        "|---|---|---|---|---|---|---|",
        *(_row(name, expected([name]), [item for item in struck if item["struck"] == [name]]) for name in STRIKES),
        _row("two of these at once", "", [item for item in struck if len(item["struck"]) > 1]),
        _row("all", "", struck),
        "",
        f"Rows lost at the end of a file: {_least_to_most(lost)} s. Load average: {_least_to_most(loads)}. Runs that"
        f" ended by themselves before they were struck, and were made again: {len(found) - len(struck)}.",
    ]
    lines += [f"\n    {item['number']} {' + '.join(item['struck'])}: {'; '.join(item['faults'])}" for item in bad]
    return "\n".join(lines) + "\n"


def _row(name: str, end: str, items: list[dict]) -> str:
    times = sorted(1e3 * max(item["stop_s"].values()) for item in items if "stop_s" in item)
    good = sum(not item["faults"] for item in items)
    if not times:
        return f"| {name} | {end} | {len(items)} | {good} | | | |"
    late = times[min(len(times) - 1, round(0.95 * len(times)))]
    return f"| {name} | {end} | {len(items)} | {good} | {statistics.median(times):.1f} | {late:.1f} | {times[-1]:.1f} |"


def _least_to_most(values: list[float]) -> str:
    return f"{min(values):.2f} to {max(values):.2f}" if values else "none"
