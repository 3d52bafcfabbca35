"""Ratings and dialects of known models; an unlisted model has no known limits."""

import math
from typing import Final, Literal

RANGES: Final = {  # volts and amperes of each range, the low one first
    "E3632A": ((15.0, 7.0), (30.0, 4.0)),
    "E3633A": ((8.0, 20.0), (20.0, 10.0)),
    "E3634A": ((25.0, 7.0), (50.0, 4.0)),
    "DP811": ((20.0, 10.0), (40.0, 5.0)),
    "DP811A": ((20.0, 10.0), (40.0, 5.0)),
}


def most(model: str) -> tuple[float, float]:
    """Highest voltage and highest current of any range."""
    ranges = RANGES.get(model, ((math.inf, math.inf),))
    return max(volts for volts, _ in ranges), max(amperes for _, amperes in ranges)


def dialect_of(model: str) -> Literal["e36xx", "dp800"] | None:
    """Dialect of a known model; None of another one."""
    if model not in RANGES:
        return None
    return "dp800" if model.startswith("DP8") else "e36xx"
