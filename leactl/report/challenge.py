"""Results of searches for courses that beat the thermal guard, as text and as JSON."""

import math
from collections.abc import Sequence

from leactl.runner.challenge.hunt import SearchResult

HEADING = f"{'role':<6}{'rate_Hz':>8}  {'angle':<9}{'courses':>8}{'below bound':>13}{'hottest':>11}  kind of course"


def challenge_text(searches: Sequence[SearchResult], limit: float) -> str:
    """Return a line for each search: how far the true temperature stayed below its bound, and the hottest phase."""
    lines = [HEADING]
    for search in searches:
        warning = "" if search.held(limit) else "  NOT HELD"
        lines.append(
            f"{search.role:<6}{search.rate_hz:>8g}  {search.reading:<9}{search.attempts:>8}{margin_text(search):>13}"
            f"{f'{search.hottest.peak:.1f} degC':>11}  {search.nearest.kind}{warning}"
        )
    return "\n".join(lines)


def margin_text(search: SearchResult) -> str:
    """Return the least distance [K] of the true temperature below its bound, as text."""
    return f"{-search.nearest.over_k:.2f} K" if math.isfinite(search.nearest.over_k) else "-"


def challenge_json(searches: Sequence[SearchResult], limit: float) -> dict[str, object]:
    """Return the searches as a JSON document; the `genes` of an attempt reproduce its course."""
    return {
        "limit_degC": limit,
        "held": all(search.held(limit) for search in searches),
        "searches": [
            {
                "role": search.role,
                "rate_Hz": search.rate_hz,
                "angle": search.reading,
                "courses": search.attempts,
                "nearest": _attempt_json(search, nearest=True),
                "hottest": _attempt_json(search, nearest=False),
            }
            for search in searches
        ],
    }


def _attempt_json(search: SearchResult, nearest: bool) -> dict[str, object]:
    """Return the attempt nearest to its bound, or the hottest one, as JSON takes it."""
    attempt = search.nearest if nearest else search.hottest
    return {
        "kind": attempt.kind,
        "above_bound_K": round(attempt.over_k, 4) if math.isfinite(attempt.over_k) else None,
        "peak_degC": round(attempt.peak, 3),
        "tripped": attempt.tripped,
        "genes": attempt.genes.tolist(),
    }
