"""What many trials gave, as a page: what must be zero, what is to be rare, and what caught plants outside the model."""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from leactl.safety.thermal.guard import MARGIN_K
from tests.monte_carlo.plants import OUTSIDE
from tests.monte_carlo.supervised import AFTER_S
from tests.monte_carlo.trial import LIMIT_DEGC, MILD_DEGC, THERMAL, Campaign, needless, violations

Told = dict[str, Any]
FROZEN = ("frozen drive", "frozen_drive")
Z = 1.959964  # of a 95 % interval
NUMBERS = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Interval of a share, 95 % (Wilson, 1927)."""
    if not of:
        return 0.0, 1.0
    share, spread = hits / of, Z * Z / of
    middle = (share + spread / 2) / (1 + spread)
    half = Z / (1 + spread) * (share * (1 - share) / of + spread / (4 * of)) ** 0.5
    return max(0.0, middle - half), min(1.0, middle + half)


def report(told: Sequence[Told], campaign: Campaign) -> str:
    """Markdown of all trials."""
    inside = [item for item in told if item["kind"] != "outside"]
    sound = [item for item in inside if item["fault"] not in FROZEN]
    frozen = [item for item in inside if item["fault"] in FROZEN]
    judged = [item for item in inside if needless(item) is not None]
    wired = [item for item in inside if item["kind"] == "wire"]
    lines = [
        f"    .venv/bin/python -m tests.monte_carlo --count {campaign.count} --wire {campaign.over_wire}"
        f" --outside {campaign.outside} --seed {campaign.seed} --results monte-carlo.jsonl --report monte-carlo.md",
        "",
        f"{len(inside)} of {campaign.count} trials inside the tolerances, {len(wired)} of them over the wire,"
        f" {sum(bool(item['fault']) for item in inside)} with a fault, {sum(item['corner'] for item in inside)} at"
        f" corners, {sum(item['start'] != 'cold' for item in inside)} from a warm start;"
        f" {len(told) - len(inside)} of {campaign.outside} outside the guard's model."
        f" {sum(item['cpu_s'] for item in told) / 3600:.2f} h of processor time and the true temperatures' own.",
        "",
        "| inside the tolerances | trials | found | 95 % interval |",
        "|---|---|---|---|",
        _row(f"hottest phase above {LIMIT_DEGC:g} degC", sound, lambda item: item["peak_degC"] > LIMIT_DEGC),
        _row("drive left energised", sound, lambda item: bool(item["energised"])),
        _row("run file unreadable or not verified", wired, lambda item: bool(item["file_faults"])),
        _row(f"fault-free, below {MILD_DEGC:g} degC undisturbed: tripped or refused", judged, lambda i: needless(i)),
        _row("of these: refused", judged, lambda item: item["forecast"] == "refused"),
        _row("of these: accepted, then tripped for a winding", judged, lambda i: needless(i) and _by_guard(i)),
        _row("of these: accepted, then ended by another limit", judged, lambda i: needless(i) and not _for_heat(i)),
        _row("of these: another plant of the box would pass the limit", judged, lambda i: needless(i) and _must(i)),
        _row("not counted: accepted, complete, but scaled down", judged, lambda i: i["scaled"] and not needless(i)),
        "",
        f"The highest of all is {max((item['peak_degC'] for item in sound), default=0.0):.2f} degC."
        f" Apart from these {len(frozen)} drives froze, deaf to everything:"
        f" {sum(bool(item['energised']) for item in frozen)} were left energised, which only their supply ends;"
        f" {sum(item['peak_degC'] > LIMIT_DEGC for item in frozen)} were above {LIMIT_DEGC:g} degC up to {AFTER_S:g} s"
        " after the end.",
        "",
        "| group | trials | complete | tripped | failed | killed | scaled | highest, degC |",
        "|---|---|---|---|---|---|---|---|",
    ]
    groups: list[tuple[str, Callable[[Told], bool]]] = [
        ("accepted by the forecast, fault-free", lambda i: i["forecast"] == "accepted" and not i["fault"]),
        ("accepted, with a fault", lambda i: i["forecast"] == "accepted" and bool(i["fault"])),
        ("refused, run all the same, fault-free", lambda i: i["forecast"] == "refused" and not i["fault"]),
        ("refused, run all the same, with a fault", lambda i: i["forecast"] == "refused" and bool(i["fault"])),
    ]
    lines += [_group(name, [item for item in sound if rule(item)]) for name, rule in groups]
    kinds = sorted({item["fault"] for item in inside if item["fault"]})
    lines += [
        "",
        "| fault | trials | complete | tripped | failed | killed | scaled | highest, degC |",
        "|---" * 8 + "|",
    ]
    lines += [_group(kind, [item for item in inside if item["fault"] == kind]) for kind in kinds]
    lines += ["", "| outside the model | trials | complete | tripped | failed | killed | scaled | highest, degC |"]
    lines += ["|---" * 8 + "|"]
    beyond = [item for item in told if item["kind"] == "outside"]
    lines += [_group(kind, [item for item in beyond if item["outside"] == kind]) for kind in OUTSIDE]
    lines += ["", "| outside the model, above 130 degC | of all trials | 95 % interval |", "|---|---|---|"]
    lines += [_above(kind, [item for item in beyond if item["outside"] == kind]) for kind in OUTSIDE]
    lines += ["", "| misread current | trials | above 130 degC | highest, degC | what told |", "|---" * 5 + "|"]
    misread = [item for item in beyond if item.get("misread")]
    lines += [_misread(kind, [i for i in misread if _class(i) == kind]) for kind in sorted(set(map(_class, misread)))]
    lines += ["", "| outside the model: what ended the run | trials |", "|---|---|"]
    lines += [f"| {name} | {count} |" for name, count in _causes(beyond)]
    bad = [item for item in inside if violations(item)]
    lines += [
        "",
        *(f"    {item['number']} {item['setup']} {item['fault']}: {'; '.join(violations(item))}" for item in bad),
    ]
    return "\n".join(lines).rstrip() + "\n"


def _row(name: str, items: Sequence[Told], rule: Callable[[Told], bool | None]) -> str:
    hits = sum(bool(rule(item)) for item in items)
    low, high = wilson(hits, len(items))
    return f"| {name} | {len(items)} | {hits} | {100 * low:.3f} to {100 * high:.3f} % |"


def _by_guard(item: Told) -> bool:
    return item["forecast"] == "accepted" and THERMAL in item["reason"]


def _must(item: Told) -> bool:
    """Whether a plant of the box would come to where a guard has to stop it, on the same protocol.

    Over the wire, where every protocol is one that the forecast accepts, it is not worked out.
    """
    return bool(item.get("corner_degC", 0.0) > LIMIT_DEGC - MARGIN_K)


def _for_heat(item: Told) -> bool:
    return item["forecast"] == "refused" or THERMAL in item["reason"]


def _group(name: str, items: Sequence[Told]) -> str:
    counts = Counter(item["status"] for item in items)
    parts = " | ".join(str(counts[status]) for status in ("complete", "tripped", "failed", "killed"))
    highest = max((item["peak_degC"] for item in items), default=0.0)
    return f"| {name} | {len(items)} | {parts} | {sum(item['scaled'] for item in items)} | {highest:.1f} |"


def _above(kind: str, items: Sequence[Told]) -> str:
    hits = sum(item["peak_degC"] > LIMIT_DEGC for item in items)
    low, high = wilson(hits, len(items))
    return f"| {kind} | {hits} of {len(items)} | {100 * low:.2f} to {100 * high:.2f} % |"


def _class(item: Told) -> str:
    """What a misread current is called: its factor, whose it is, and the set-up, on which hangs what else tells."""
    return f"{item['misread']}, {item['setup']}"


def _misread(kind: str, items: Sequence[Told]) -> str:
    hot = sum(item["peak_degC"] > LIMIT_DEGC for item in items)
    told = Counter(_what_told(item) for item in items)
    causes = ", ".join(f"{name} {count}" for name, count in told.most_common())
    return f"| {kind} | {len(items)} | {hot} | {max(item['peak_degC'] for item in items):.1f} | {causes} |"


def _what_told(item: Told) -> str:
    """The sensor that contradicted, or what else ended the run."""
    if " contradicts " in item["reason"]:
        return str(item["reason"]).partition(" contradicts ")[2].partition(",")[0]
    return "the bound" if THERMAL in item["reason"] else "a limit" if item["reason"] else "nothing"


def _causes(items: Iterable[Told]) -> list[tuple[str, int]]:
    """Reasons with their numbers left out."""
    found: Counter[str] = Counter()
    for item in items:
        reason = item["reason"].partition(" times as much")[0]  # the conventions near it are in a table of their own
        cause = NUMBERS.sub("#", reason).replace("|", "/") if reason else item["status"]
        found[f"{item['outside']}: {cause}"] += 1
    return found.most_common()
