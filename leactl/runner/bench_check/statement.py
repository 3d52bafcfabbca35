"""Compare a statement of a bench file with what the bench shows."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from leactl.bench.benchfile import CheckedDevice
from leactl.runner.request import Request

DEVIATION_STDS = 3.0  # standard errors by which a value has to differ to count as different


class StatementVerdict(StrEnum):
    """Whether the bench confirms a statement, contradicts it, or does not show either."""

    OK = "ok"
    WRONG = "wrong"
    UNDECIDED = "cannot tell"


@dataclass(frozen=True)
class Statement:
    """A measured value, the range expected by the bench file, and the verdict; an unknown number is NaN."""

    device: str
    about: str  # the quantity or property that is judged
    verdict: StatementVerdict
    measured: float = math.nan
    std: float = math.nan  # of the readings at rest, or standard error of a fitted value
    units: str = ""
    low: float = math.nan  # of the expected range
    high: float = math.nan
    why: str = ""
    change: str = ""  # the line of the bench file, and what it should say

    def as_json(self) -> dict[str, Any]:
        """Return the statement as `--json` prints it; a number that is not finite becomes null."""
        numbers = {name: getattr(self, name) for name in ("measured", "std", "low", "high")}
        finite = {name: number if math.isfinite(number) else None for name, number in numbers.items()}
        texts = {name: str(getattr(self, name)) for name in ("device", "about", "verdict", "units", "why", "change")}
        return texts | finite


def ratio(device: str, about: str, value: float, std: float, bound: float) -> Statement:
    """Judge a measured ratio that should be 1.

    Parameters
    ----------
    std : standard error of the ratio.
    bound : largest difference from 1 that a sound bench may show.
    """
    margin = bound + DEVIATION_STDS * std
    sound = abs(value - 1.0) <= margin
    if not math.isfinite(margin) or (sound and margin > 2.0 * bound):
        return Statement(
            device, about, StatementVerdict.UNDECIDED, value, std, "1", why="the move shows too little of it"
        )
    return Statement(
        device,
        about,
        StatementVerdict.OK if sound else StatementVerdict.WRONG,
        value,
        std,
        "1",
        1.0 - margin,
        1.0 + margin,
    )


def wrong(statements: Iterable[Statement]) -> list[Statement]:
    """Return the statements that the bench contradicts."""
    return [statement for statement in statements if statement.verdict is StatementVerdict.WRONG]


def setting(request: Request, device: CheckedDevice, names: Iterable[str], advice: str) -> str:
    """Return advice on a setting, preceded by its location in the bench file.

    Parameters
    ----------
    names : settings, of which the first that the driver has is located, or the block of settings if it has none.
    """
    available = [name for name in names if name in type(device.settings).model_fields]
    return request.bench_document.fault(("devices", device.name, "settings", *available[:1]), advice)
