"""Result of a diagnosis, and its JSON form (format "leactl-gap", version 1)."""

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

FORMAT, VERSION = "leactl-gap", 1
LEAST_GAP_FLOORS = 1.1  # floors; a smaller distance counts as no gap
MOST_REPLAY_MISS = 6.0  # floors, largest distance of a replay by the right model
ZERO_ANGLE = "load.zero_angle"  # parameter of the model's arm
Verdict = Literal["none", "calibration", "effect", "unknown"]
Presence = Literal["alike", "differs", "absent", "not asked"]  # of a simulator's effect in the real runs


@dataclass(frozen=True)
class Region:
    """Interval of one variable that holds most of a gap."""

    variable: str
    low: float
    high: float
    units: str
    within_turn: bool = False  # whether whole turns are taken off an angle


@dataclass(frozen=True)
class Where:
    """Distance of the model from the data in one channel and set-up, and the region of the gap."""

    quantity: str
    role: str
    mechanical: str
    units: str
    nominal_rms: float
    calibrated_rms: float
    floor_rms: float
    region: Region | None = None
    share: float = 0.0  # share of the squared calibrated residual that lies inside the region


@dataclass(frozen=True)
class CalibratedParameter:
    """A calibrated parameter of the nominal model."""

    parameter: str
    nominal: float
    fitted: float
    std: float  # standard error; that of the prior where these runs do not determine the parameter
    units: str
    not_told_by_these_runs: bool = False  # it stays at its nominal value

    @property
    def has_ratio(self) -> bool:
        """Whether the ratio of fitted to nominal value is meaningful; an offset may be nominally near zero."""
        return self.nominal != 0.0 and self.parameter not in ("ambient_offset", ZERO_ANGLE)


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect."""

    name: str
    value: float
    std: float  # standard error
    units: str


@dataclass(frozen=True)
class ResidualBin:
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
    """Residual of an equation on held-out runs in bins of the variable that an effect acts in."""

    variable: str
    variable_units: str
    periods: float | None  # parts of a turn that an angle is folded by; None where it is not folded
    along: str | None  # what the residual is multiplied by the sign of: a variable, or a text; None for no sign
    quantity: str
    role: str
    mechanical: str
    equation: str
    units: str
    before_rms: float  # of the bin means, weighted by their samples
    after_rms: float
    off_zero_before: int  # bins whose interval does not contain zero
    off_zero_after: int
    bins: tuple[ResidualBin, ...]
    # whether `before` is a fit without the effect, or only has the effect added back; None where nothing is fitted
    refitted: bool | None = None


@dataclass(frozen=True)
class Cause:
    """One effect with its probability of being present."""

    effect: str
    probability: float
    share: float  # of what all members of the set explain; for a set-up fault, of its channel's squared error
    parameters: tuple[EffectParameter, ...]
    indistinguishable_from: tuple[str, ...] = ()
    separating_experiment: str | None = None
    family: str = ""  # machine, sensor, drive, thermal or setup
    change: str | None = None  # line that undoes a fault of the set-up
    picture: Picture | None = None  # picture of an effect in the augmented model, or of an alternative to it


@dataclass(frozen=True)
class Near:
    """An effect that nearly explains the residual, and why it was refused."""

    effect: str
    refused_because: str


@dataclass(frozen=True)
class Rest:
    """Unexplained residual of the channel that is farthest from a sound machine's, and what it depends on."""

    depends_on: tuple[str, ...]  # variables of the state, or time, or nothing that is logged
    repeats_Hz: float | None  # noqa: N815 (a unit keeps its letter)  frequency of its sine in time; None without one
    closable: float | None  # share of the held-out gap that a free function of the state closes; None without a gap
    quantity: str
    role: str
    mechanical: str
    equation: str
    shapes: tuple[Picture, ...]  # over each variable, before and after that function
    nearest: tuple[Near, ...]
    experiment: str | None  # shipped protocol that separates the possible effects


@dataclass(frozen=True)
class Shrinkage:
    """Shrinkage of the gap of one channel on held-out runs."""

    quantity: str
    role: str
    mechanical: str
    units: str
    nominal_rms: float
    calibrated_rms: float
    augmented_rms: float
    floor_rms: float
    closed: float | None = None  # share of the calibrated gap that the effects close, with its 95 % interval
    closed_low: float | None = None
    closed_high: float | None = None


@dataclass(frozen=True)
class SimulatedRun:
    """A simulated run and the real run with the same inputs."""

    real: str  # path
    simulated: str
    paired_by: Literal["name", "experiment", "inputs", "order"]


@dataclass(frozen=True)
class EffectiveParameter:
    """A parameter of the model, fitted to the simulated and to the real runs."""

    parameter: str
    start: float  # value from which the fits began
    simulated: float
    simulated_std: float
    real: float | None  # null where nothing is calibrated for the real runs
    real_std: float | None
    differs: bool  # whether the two differ beyond both uncertainties
    units: str


@dataclass(frozen=True)
class SizeInBoth:
    """A parameter of a simulator's effect, fitted to the simulated and in the same form to the real runs."""

    name: str
    simulated: float
    simulated_std: float
    real: float | None  # null where it was not fitted to the real runs
    real_std: float | None
    units: str


@dataclass(frozen=True)
class SimulatorEffect:
    """An effect that the simulator itself shows against the plain form of the model, or a fault of its set-up."""

    effect: str
    in_real: Presence
    parameters: tuple[SizeInBoth, ...]
    indistinguishable_from: tuple[str, ...] = ()


@dataclass(frozen=True)
class SimulatorFloor:
    """Residual of one channel of the simulator's held-out runs against its fitted form."""

    quantity: str
    role: str
    mechanical: str
    units: str
    left_rms: float  # residual beyond the floor
    floor_rms: float  # floor of noise and replay


@dataclass(frozen=True)
class SimulatorAnswer:
    """Diagnosis of the simulator whose runs replace the nominal model."""

    verdict: Verdict  # of the simulated runs against the plain form
    unexplained_probability: float
    runs: tuple[SimulatedRun, ...]
    parameters: tuple[EffectiveParameter, ...]
    effects: tuple[SimulatorEffect, ...]
    floors: tuple[SimulatorFloor, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class DiagnosisResult:
    """The whole result of a diagnosis."""

    verdict: Verdict
    unexplained_probability: float
    where: tuple[Where, ...] = ()
    calibration: tuple[CalibratedParameter, ...] = ()
    causes: tuple[Cause, ...] = ()
    shrinkage: tuple[Shrinkage, ...] = ()
    notes: tuple[str, ...] = ()
    unexplained: Rest | None = None  # where something acts that no effect explains
    extra: dict[str, Any] = field(default_factory=dict, compare=False)  # for reports, not part of the JSON
    simulator: SimulatorAnswer | None = None  # where simulated runs are the nominal; else not part of the JSON

    def as_json(self) -> dict[str, Any]:
        """Return the JSON document; a number that is not finite is null."""
        body = asdict(replace(self, extra={}))
        body.pop("extra")
        if self.simulator is None:
            body.pop("simulator")
        document: dict[str, Any] = _finite({"format": FORMAT, "format_version": VERSION, **body})
        return document


def _finite(value: Any) -> Any:
    """Return a document with None in place of numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
