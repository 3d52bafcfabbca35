"""What a search for courses that beat the thermal guard has found, as text."""

import math
from collections.abc import Sequence

from leactl.runner.challenge.hunt import Hunted

HEAD = f"{'role':<6}{'rate_Hz':>8}  {'angle':<9}{'courses':>8}{'below bound':>13}{'hottest':>11}  kind of course"


def challenge_text(found: Sequence[Hunted], limit: float) -> str:
    """A line for each search: how near the truth came to its bound, and how hot any phase became."""
    lines = [HEAD]
    for one in found:
        kept = "" if one.held(limit) else "  NOT HELD"
        lines.append(
            f"{one.role:<6}{one.rate_hz:>8g}  {one.reading:<9}{one.attempts:>8}{below(one):>13}"
            f"{f'{one.hottest.peak:.1f} degC':>11}  {one.nearest.kind}{kept}"
        )
    return "\n".join(lines)


def below(one: Hunted) -> str:
    """How far the truth stayed below its bound where it came nearest."""
    return f"{-one.nearest.over_k:.2f} K" if math.isfinite(one.nearest.over_k) else "-"


def told(found: Sequence[Hunted], limit: float) -> dict[str, object]:
    """The same for a program; genes make a course again."""
    return {
        "limit_degC": limit,
        "held": all(one.held(limit) for one in found),
        "searches": [
            {
                "role": one.role,
                "rate_Hz": one.rate_hz,
                "angle": one.reading,
                "courses": one.attempts,
                "nearest": _attempt(one, nearest=True),
                "hottest": _attempt(one, nearest=False),
            }
            for one in found
        ],
    }


def _attempt(one: Hunted, nearest: bool) -> dict[str, object]:
    attempt = one.nearest if nearest else one.hottest
    return {
        "kind": attempt.kind,
        "above_bound_K": round(attempt.over_k, 4) if math.isfinite(attempt.over_k) else None,
        "peak_degC": round(attempt.peak, 3),
        "tripped": attempt.tripped,
        "genes": attempt.genes.tolist(),
    }
