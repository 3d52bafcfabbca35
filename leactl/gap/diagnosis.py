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
    std: float  # of one that these runs do not tell, that of what is usual
    units: str
    not_told_by_these_runs: bool = False  # it stays at its nominal value


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect."""

    name: str
    value: float
    std: float
    units: str


@dataclass(frozen=True)
class Bin:
    """Mean residual of a stretch of a variable, with its 95 % interval, before and after an effect is added."""

    low: float
    high: float
    count: int
    before: float
    before_low: float
    before_high: float
    after: float
    after_low: float
    after_high: float


@dataclass(frozen=True)
class Picture:
    """What an equation leaves over on held-out runs, over the variable that an effect acts in."""

    variable: str
    variable_units: str
    periods: float | None  # of an angle: how many parts of a turn lie on each other
    along: str | None  # variable along whose sign the residual is counted; None where it is taken as it is
    quantity: str
    role: str
    mechanical: str
    equation: str
    units: str
    before_rms: float  # of the means in bins, each counted by its samples
    after_rms: float
    off_zero_before: int  # bins whose interval does not hold zero
    off_zero_after: int
    bins: tuple[Bin, ...]


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
    picture: Picture | None = None  # of an effect that stands in the augmented model


@dataclass(frozen=True)
class Near:
    """An effect that comes near to explaining what is left, and why it was refused."""

    effect: str
    refused_because: str


@dataclass(frozen=True)
class Rest:
    """What is not explained: of the channel that is farthest from a sound machine's, what it depends on."""

    depends_on: tuple[str, ...]  # variables of the state, or time, or nothing that is logged
    repeats_Hz: float | None  # noqa: N815 (a unit keeps its letter)  how often it repeats in time; None where it does not
    closable: float | None  # share of the held-out gap that a free function of the state closes; None where no gap is
    quantity: str
    role: str
    mechanical: str
    equation: str
    shapes: tuple[Picture, ...]  # over each variable, before and after that function
    nearest: tuple[Near, ...]
    experiment: str | None  # the shipped protocol that would decide


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
    unexplained: Rest | None = None  # where something acts that no effect explains
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
