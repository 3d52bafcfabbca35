"""One statement of a bench file, held against what the bench shows."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from leactl.bench.benchfile import CheckedDevice
from leactl.runner.request import Request

SURE = 3.0  # standard errors


class StatementVerdict(StrEnum):
    """What the bench says of a statement."""

    OK = "ok"
    WRONG = "wrong"
    OPEN = "cannot tell"


@dataclass(frozen=True)
class Statement:
    """What was measured beside what the bench file lets expect; a number that is not known is NaN."""

    device: str
    about: str
    verdict: StatementVerdict
    measured: float = math.nan
    std: float = math.nan
    units: str = ""
    low: float = math.nan  # expected
    high: float = math.nan
    why: str = ""
    change: str = ""  # the line of the bench file, and what it should say

    def as_json(self) -> dict[str, Any]:
        """The statement as `--json` prints it: what is not finite becomes null."""
        numbers = {name: getattr(self, name) for name in ("measured", "std", "low", "high")}
        finite = {name: number if math.isfinite(number) else None for name, number in numbers.items()}
        texts = {name: str(getattr(self, name)) for name in ("device", "about", "verdict", "units", "why", "change")}
        return texts | finite


def ratio(device: str, about: str, value: float, std: float, bound: float) -> Statement:
    """Hold a ratio, with its standard error, against 1; `bound` is what a sound bench may miss it by."""
    margin = bound + SURE * std
    sound = abs(value - 1.0) <= margin
    if not math.isfinite(margin) or (sound and margin > 2.0 * bound):
        return Statement(device, about, StatementVerdict.OPEN, value, std, "1", why="the move tells too little of it")
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
    """Statements that the bench contradicts."""
    return [each for each in statements if each.verdict is StatementVerdict.WRONG]


def setting(request: Request, device: CheckedDevice, names: Iterable[str], advice: str) -> str:
    """The line of the first of these settings that the device's driver has, else of all of them, with what to do."""
    known = [name for name in names if name in type(device.settings).model_fields]
    return request.bench_document.fault(("devices", device.name, "settings", *known[:1]), advice)
