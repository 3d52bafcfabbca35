"""What runs or protocols can reveal, as text and as JSON."""

import textwrap
from typing import Any

from leactl.gap.planning.advice import Advice, Experiment
from leactl.gap.planning.reveal import Sight
from leactl.vocabulary.effect import effect_definition

FORMAT, VERSION = "leactl-gap-plan", 1


def as_json(advice: Advice) -> dict[str, Any]:
    """The advice for other programs."""
    effects = [
        {
            "effect": s.effect,
            "found_from": s.smallest,
            "worth_knowing": s.faint,
            "units": s.units,
            "shown": s.seen,
            "indistinguishable_from": list(s.alike),
        }
        for s in advice.sights
    ]
    experiments = [
        {
            "protocol": e.protocol,
            "duration_s": e.duration_s,
            "shows": list(e.shows),
            "separates": [list(pair) for pair in e.separates],
            "gain_per_s": e.gain,
        }
        for e in advice.experiments
    ]
    return {
        "format": FORMAT,
        "format_version": VERSION,
        "effects": effects,
        "experiments": experiments,
        "not_shown": list(advice.dark),
        "notes": list(advice.notes),
    }


def lines(advice: Advice) -> list[str]:
    """The advice line by line: effects, then experiments, then what stays in the dark."""
    width = max(len(s.effect) for s in advice.sights)
    out = [f"{'effect':<{width}}  found from  worth knowing"]
    out += [sight_line(s, width) for s in advice.sights]
    if advice.experiments:
        out += ["", "one experiment more, most answers per second first"]
        for e in advice.experiments:
            out += experiment_lines(e)
    if advice.dark:
        out += ["", "not shown at that size by any one of these"]
        out += [f"  {name:<{width}}  {effect_definition(name).shown_by}" for name in advice.dark]
    out += [f"note: {note}" for note in advice.notes]
    return out


def sight_line(s: Sight, width: int) -> str:
    """One effect."""
    found = "invisible" if s.smallest is None else f"{s.smallest:.2g}"
    mark = "" if s.seen else "  not shown"
    alike = f"  looks like {', '.join(s.alike)}" if s.alike else ""
    units = "" if s.units == "1" else f" {s.units}"
    worth = "-" if s.faint is None else f"{s.faint:.2g}{units}"
    return f"{s.effect:<{width}}  {found:>10}  {worth:<20}{mark}{alike}".rstrip()


def experiment_lines(e: Experiment) -> list[str]:
    """One protocol and what it adds."""
    out = [f"  leactl run {e.protocol}  ({e.duration_s:.0f} s)"]
    if e.shows:
        out += wrapped(f"shows {', '.join(e.shows)}")
    if e.separates:
        out += wrapped(f"tells apart {', '.join(f'{one} / {other}' for one, other in e.separates)}")
    return out


def wrapped(text: str) -> list[str]:
    """A long list within 80 columns."""
    return textwrap.wrap(text, 80, initial_indent="    ", subsequent_indent="      ")
