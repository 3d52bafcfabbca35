"""What a diagnosis says, and its JSON form (format "leactl-gap", version 1)."""

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

FORMAT, VERSION = "leactl-gap", 1
Verdict = Literal["none", "calibration", "effect", "unknown"]


@dataclass(frozen=True)
class Region:
    """The stretch of one variable that holds most of a gap."""

    variable: str
    low: float
    high: float
    units: str


@dataclass(frozen=True)
class Where:
    """One channel in one kind of run: how far the model is from the data, and where."""

    quantity: str
    role: str
    mechanical: str
    units: str
    nominal_rms: float
    calibrated_rms: float
    floor_rms: float
    region: Region | None = None
    share: float = 0.0  # of the squared calibrated residual inside the region


@dataclass(frozen=True)
class CalibratedParameter:
    """A parameter of the nominal model, fitted again."""

    parameter: str
    nominal: float
    fitted: float
    std: float
    units: str


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect."""

    name: str
    value: float
    std: float
    units: str


@dataclass(frozen=True)
class Cause:
    """One effect with its probability of being present."""

    effect: str
    probability: float
    share: float
    parameters: tuple[EffectParameter, ...]
    indistinguishable_from: tuple[str, ...] = ()
    separating_experiment: str | None = None
    family: str = ""  # machine, sensor, drive, thermal or setup
    change: str | None = None  # of a fault of the set-up: the line that undoes it


@dataclass(frozen=True)
class Shrinkage:
    """How far the gap of one channel shrinks on held-out runs."""

    quantity: str
    role: str
    mechanical: str
    units: str
    nominal_rms: float
    calibrated_rms: float
    augmented_rms: float
    floor_rms: float
    closed: float | None = None
    closed_low: float | None = None
    closed_high: float | None = None


@dataclass(frozen=True)
class Diagnosis:
    """The whole answer."""

    verdict: Verdict
    unexplained_probability: float
    where: tuple[Where, ...] = ()
    calibration: tuple[CalibratedParameter, ...] = ()
    causes: tuple[Cause, ...] = ()
    shrinkage: tuple[Shrinkage, ...] = ()
    notes: tuple[str, ...] = ()
    extra: dict[str, Any] = field(default_factory=dict, compare=False)  # for reports, not part of the JSON

    def as_json(self) -> dict[str, Any]:
        """The document; a number that is not known is null."""
        body = asdict(replace(self, extra={}))
        body.pop("extra")
        clean: dict[str, Any] = _finite({"format": FORMAT, "format_version": VERSION, **body})
        return clean


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
