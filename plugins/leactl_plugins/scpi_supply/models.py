"""Ratings, outputs and dialects of known models; an unlisted model has one output without known limits.

An output with a negative or a fixed voltage is not listed, because it cannot feed a motor as commanded.
"""

import math
from collections.abc import Mapping
from typing import Final, Literal

Dialect = Literal["e36xx", "e36300", "dp800", "spd3303"]
Rating = tuple[float, float]  # V and A

RANGES: Final[Mapping[str, tuple[Rating, ...]]] = {  # of models with one output, by model, the low range first
    "E3632A": ((15.0, 7.0), (30.0, 4.0)),
    "E3633A": ((8.0, 20.0), (20.0, 10.0)),
    "E3634A": ((25.0, 7.0), (50.0, 4.0)),
    "DP811": ((20.0, 10.0), (40.0, 5.0)),
    "DP811A": ((20.0, 10.0), (40.0, 5.0)),
}
_DP821 = {1: (60.0, 1.0), 2: (8.0, 10.0)}
_DP831 = {1: (8.0, 5.0), 2: (30.0, 2.0)}  # output 3 is negative
_DP832 = {1: (30.0, 3.0), 2: (30.0, 3.0), 3: (5.0, 3.0)}
_SPD3303X = {1: (32.0, 3.2), 2: (32.0, 3.2)}  # output 3 takes no level and reports nothing
OUTPUTS: Final[Mapping[str, Mapping[int, Rating]]] = {  # of models with several outputs, by model and number
    "E36311A": {1: (6.0, 5.0), 2: (25.0, 1.0)},  # output 3 is negative
    "E36312A": {1: (6.0, 5.0), 2: (25.0, 1.0), 3: (25.0, 1.0)},
    "E36313A": {1: (6.0, 10.0), 2: (25.0, 2.0), 3: (25.0, 2.0)},
    "DP821": _DP821,
    "DP821A": _DP821,
    "DP831": _DP831,
    "DP831A": _DP831,
    "DP832": _DP832,
    "DP832A": _DP832,
    "SPD3303X": _SPD3303X,
    "SPD3303X-E": _SPD3303X,
}
TRACKING: Final[Mapping[str, tuple[int, ...]]] = {  # outputs of which one can follow the other
    "DP831": (2, 3),
    "DP831A": (2, 3),
    "DP832": (1, 2),
    "DP832A": (1, 2),
}
_DIALECT_BY_PREFIX: Final[Mapping[str, Dialect]] = {
    "E3631": "e36300",
    "E363": "e36xx",
    "DP8": "dp800",
    "SPD3303": "spd3303",
}


def highest_rating(model: str, output: int) -> Rating:
    """Return the highest voltage [V] and current [A] of a model's output in any range; output 0 is the only one."""
    if output:
        return OUTPUTS[model][output]
    ranges = RANGES.get(model, ((math.inf, math.inf),))
    return max(volts for volts, _ in ranges), max(amperes for _, amperes in ranges)


def dialect_of(model: str) -> Dialect | None:
    """Return the dialect of a model; None if the model is not known."""
    if model not in RANGES and model not in OUTPUTS:
        return None
    return next(dialect for prefix, dialect in _DIALECT_BY_PREFIX.items() if model.startswith(prefix))


def models_of(dialect: Dialect) -> list[str]:
    """Return the known models of a dialect."""
    return [model for model in (*RANGES, *OUTPUTS) if dialect_of(model) == dialect]


def output_trouble(model: str, output: int | None) -> str:
    """Return why a model cannot be used with this setting of `output`; empty if it can."""
    numbers = sorted(OUTPUTS.get(model, {1: ()}))
    expected = f"{numbers[0]} to {numbers[-1]}" if len(numbers) > 1 else f"{numbers[0]}"
    if output is None:
        return f"output is missing: {model} has several, {expected} was expected" if model in OUTPUTS else ""
    return "" if output in numbers else f"output {output} of {model} cannot be served; {expected} was expected"
