"""Define the types of values in protocol files, the blocks of acceptance limits, and the head of the file."""
# ruff: noqa: N815 (a unit keeps its letter)

import math
from collections.abc import Collection, Iterator, Mapping
from difflib import get_close_matches
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

from leactl.protocol.setpointkeys import Spelling
from leactl.quantities import UNITS
from leactl.units import CONVERSIONS, converter
from leactl.vocabulary.effect import effect_names
from leactl.yamlblock import Block

MAX_DURATION_S = 7 * 24 * 3600.0  # of a protocol
MAX_ACTIONS = 100_000  # of an expanded protocol
MAX_SAMPLES = 5_000_000  # of all signals of a protocol

# Strict: YAML's `true` and quoted numbers are not numbers here. 1e6 bounds every setpoint, so that no sum overflows.
Setpoint = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]
Amount = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1e6)]
Rate = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1e9)]
Duration = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=MAX_DURATION_S)]
Rest = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=MAX_DURATION_S)]
Frequency = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-6, le=1e5)]
Count = Annotated[int, Field(strict=True, ge=1, le=MAX_ACTIONS)]
Seed = Annotated[int, Field(strict=True, ge=0, lt=2**63)]
Levels = Annotated[tuple[Setpoint, ...], Field(min_length=1)]
Role = Literal["test", "load"]
Sign = Literal[1, -1]


class Driven(Block):
    """A block whose setpoint keys depend on the role's mode; `needs` and `takes` are stems as in setpointkeys.py."""

    needs: ClassVar[tuple[str, ...]] = ()
    takes: ClassVar[tuple[str, ...]] = ()

    def value_of(self, spelling: Spelling, stem: str) -> Any:
        """Return the value of the block's key for a stem in a spelling; None if the block has no value for it."""
        return getattr(self, spelling.key(stem))


def _known_effect(name: str) -> str:
    """Return the name; raise ValueError if no effect of the library has it."""
    if name not in effect_names():
        raise ValueError(f"effect '{name}' is not known; known: {', '.join(effect_names())}")
    return name


def _known_quantity(name: str) -> str:
    """Return the name; raise ValueError if it is not a quantity of the vocabulary."""
    if name not in UNITS:
        raise ValueError(f"quantity '{name}' is not in the vocabulary; known: {', '.join(sorted(UNITS))}")
    return name


Quantity = Annotated[str, AfterValidator(_known_quantity)]
EffectName = Annotated[str, AfterValidator(_known_effect)]
Bound = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Unit = Annotated[str, Field(min_length=1, max_length=20)]


class ResultLimit(Block):
    """Bounds of a result of the analysis."""

    result: Annotated[str, Field(pattern=r"^[a-z][A-Za-z0-9_]*$", max_length=80)]
    low: Bound | None = None
    high: Bound | None = None
    unit: Unit

    def misfits(self, _steps: Collection[str], _searches: Mapping[str, str]) -> Iterator[tuple[str, str]]:
        """Yield each key at fault, with the reason; whether the analysis has the result is checked later."""
        yield from _faults_of_bounds(self)


class ChannelLimit(Block):
    """Bounds of a channel in every step of a name, without its settle time; checked without an analysis."""

    channel: Quantity
    role: Literal["test", "load", "bench"] = "test"
    step: Annotated[str, Field(max_length=40)] = ""
    statistic: Literal["mean", "min", "max", "std"]
    low: Bound | None = None
    high: Bound | None = None
    unit: Unit
    stop: Annotated[bool, Field(strict=True)] = False

    def misfits(self, steps: Collection[str], _searches: Mapping[str, str]) -> Iterator[tuple[str, str]]:
        """Yield each key at fault, with the reason; `steps` are the names of the protocol's steps."""
        yield from _faults_of_bounds(self)
        yield from _faults_of_unit(self.unit, self.channel, self.channel)
        if self.step and self.step not in steps:
            matches = get_close_matches(self.step, steps, n=1)
            expected = matches[0] if matches else f"one of {', '.join(steps)}" if steps else "a step with a duration"
            yield "step", f"'{self.step}' is the name of no step; {expected} was expected"
        bound_by_statistic = {"max": self.high, "min": self.low}
        if self.stop and bound_by_statistic.get(self.statistic) is None:
            yield "stop", "max with high, or min with low, is what can be known before a step is over"


class BisectLimit(Block):
    """Bounds that must contain the whole final interval of a bisection; checked without an analysis."""

    bisect: Annotated[str, Field(max_length=40)]
    low: Bound | None = None
    high: Bound | None = None
    unit: Unit

    def misfits(self, _steps: Collection[str], searches: Mapping[str, str]) -> Iterator[tuple[str, str]]:
        """Yield each key at fault, with the reason; `searches` has the setpoint's quantity by bisection."""
        yield from _faults_of_bounds(self)
        if self.bisect in searches:
            yield from _faults_of_unit(self.unit, searches[self.bisect], self.bisect)
        else:
            expected = f"one of {', '.join(searches)}" if searches else "a bisect step"
            yield "bisect", f"'{self.bisect}' is the name of no bisection; {expected} was expected"


def _faults_of_unit(unit: str, quantity: str, name: str) -> Iterator[tuple[str, str]]:
    """Yield the key `unit`, with the reason, if the unit does not convert to that of the quantity."""
    conversion = converter(unit, quantity)
    if conversion is None or conversion.target != UNITS[quantity]:
        units = ", ".join(CONVERSIONS[UNITS[quantity]])
        yield "unit", f"{unit!r}: {name} is in {UNITS[quantity]}; one of {units} was expected"


def _faults_of_bounds(limit: ResultLimit | ChannelLimit | BisectLimit) -> Iterator[tuple[str, str]]:
    """Yield the key at fault, with the reason, if a limit has no bound or its bounds are in the wrong order."""
    if limit.low is None and limit.high is None:
        yield "", "low, high or both were expected"
    elif limit.low is not None and limit.high is not None and limit.low > limit.high:
        yield "low", f"{limit.low:g} is above high ({limit.high:g})"


def _limit_tag(block: Any) -> str:
    """Return the tag of the limit type that a block of the file has."""
    keys = block if isinstance(block, Mapping) else ()
    return "[channel]" if "channel" in keys else "[bisect]" if "bisect" in keys else "[result]"


Limit = Annotated[
    Annotated[ResultLimit, Tag("[result]")]
    | Annotated[ChannelLimit, Tag("[channel]")]
    | Annotated[BisectLimit, Tag("[bisect]")],
    Discriminator(_limit_tag),
]


class Head(Block):
    """Keys of a protocol file; parameters, conditions and steps are checked separately, to report all faults."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", max_length=60)]
    title: Annotated[str, Field(max_length=200)] = ""
    setup: Literal["free", "locked", "coupled", "heated"]
    analysis: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_-]*$", max_length=60)] = ""
    rate_Hz: Annotated[float, Field(strict=True, gt=0, le=10_000)]
    record_Hz: Annotated[float, Field(strict=True, gt=0, le=10_000)] | None = None
    parameters: Any = None
    conditions: Any = None
    steps: Annotated[list[Any], Field(min_length=1)]
    acceptance: tuple[Limit, ...] = ()
    separates: tuple[EffectName, ...] = ()
    needs: tuple[Quantity, ...] = ()
    wants: tuple[Quantity, ...] = ()
    attended: Annotated[bool, Field(strict=True)] = False


def divides(part_hz: float, whole_hz: float) -> bool:
    """Return whether `part_hz` is `whole_hz` divided by a whole number."""
    ratio = whole_hz / part_hz
    return 1 - 1e-9 < ratio < math.inf and abs(ratio - round(ratio)) < 1e-9 * ratio
