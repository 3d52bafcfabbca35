"""What every block of a protocol file has in common: closed sets of keys, strict numbers, and the file's head."""
# ruff: noqa: N815 (a unit keeps its letter)

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from leactl.protocol.setpointkeys import Spelling
from leactl.quantities import UNITS
from leactl.vocabulary.effect import effect_names

MAX_DURATION_S = 7 * 24 * 3600.0
MAX_ACTIONS = 100_000
MAX_SAMPLES = 5_000_000

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


MOST_GUESSES = 20  # unknown keys of one block for which the one that was meant is looked for
_PLAINLY = {
    "float_type": "a number was expected",
    "int_type": "a whole number was expected",
    "string_type": "a text was expected",
    "list_type": "a list was expected",
    "tuple_type": "a list was expected",
    "too_short": "at least one item was expected",
    "string_too_short": "a text was expected",
    "finite_number": "a finite number was expected",
}


class Block(BaseModel):
    """A mapping with a closed set of keys; a key that it lacks is answered with the one that was probably meant."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="wrap")
    @classmethod
    def _name_what_was_expected(cls, given: Any, build: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return build(given)
        except ValidationError as error:
            meant = cls._meant(given)
            items = error.errors(include_url=False)
            kept = [item for item in items if not cls._follows_from_another(item, items, meant)]
            raise ValidationError.from_exception_data(
                cls.__name__, [cls._reworded(item, meant) for item in kept]
            ) from None

    @classmethod
    def _meant(cls, given: Any) -> dict[str, str]:
        if not isinstance(given, Mapping):
            return {}
        unknown = [key for key in given if key not in cls.model_fields][:MOST_GUESSES]
        free = [key for key in cls.model_fields if key not in given]
        close = {key: get_close_matches(str(key)[:80], free, n=1) for key in unknown}
        return {key: found[0] for key, found in close.items() if found}

    @staticmethod
    def _follows_from_another(item: Any, items: Sequence[Any], meant: Mapping[str, str]) -> bool:
        """A key is missing because it is misspelt; a list is too short because an item of it is faulty."""
        place = item["loc"]
        if item["type"] == "missing":
            return len(place) == 1 and place[0] in meant.values()
        return item["type"] == "too_short" and any(
            len(other["loc"]) > len(place) for other in items if other["loc"][: len(place)] == place
        )

    @classmethod
    def _reworded(cls, item: Any, meant: Mapping[str, str]) -> InitErrorDetails:
        kind, message, place = item["type"], item["msg"], item["loc"]
        if kind == "extra_forbidden" and len(place) == 1:
            expected = meant.get(place[0]) or "one of " + ", ".join(cls.model_fields)
            kind, message = "unknown_key", f"unknown key; {expected} was expected"
        elif kind == "model_type" and not place:
            message = f"a mapping with keys of {', '.join(cls.model_fields)} was expected"
        message = _PLAINLY.get(kind, message)
        return InitErrorDetails(type=PydanticCustomError(kind, message), loc=place, input=item["input"])


class Driven(Block):
    """A block whose setpoint keys follow the role's mode; stems as in setpointkeys.py."""

    needs: ClassVar[tuple[str, ...]] = ()
    takes: ClassVar[tuple[str, ...]] = ()

    def given(self, spelling: Spelling, stem: str) -> Any:
        """The value of the stem's key under this spelling; None where it was left out."""
        return getattr(self, spelling.key(stem))


class Limit(Block):
    """Bounds that a result of the analysis must keep; `unit` is compared with the result's own by whoever judges."""

    result: Annotated[str, Field(pattern=r"^[a-z][A-Za-z0-9_]*$", max_length=80)]
    low: Annotated[float, Field(strict=True, allow_inf_nan=False)] | None = None
    high: Annotated[float, Field(strict=True, allow_inf_nan=False)] | None = None
    unit: Annotated[str, Field(min_length=1, max_length=20)]


def _known_effect(name: str) -> str:
    if name not in effect_names():
        raise ValueError(f"effect '{name}' is not known; known: {', '.join(effect_names())}")
    return name


def _known_quantity(name: str) -> str:
    if name not in UNITS:
        raise ValueError(f"quantity '{name}' is not in the vocabulary; known: {', '.join(sorted(UNITS))}")
    return name


Quantity = Annotated[str, AfterValidator(_known_quantity)]
EffectName = Annotated[str, AfterValidator(_known_effect)]


class Head(Block):
    """The whole file; parameters, conditions and steps are read on their own, so that every fault is found at once."""

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


def divides(part_hz: float, whole_hz: float) -> bool:
    """Whether every so-manyth cycle of a loop gives the part's rate."""
    ratio = whole_hz / part_hz
    return ratio > 1 - 1e-9 and abs(ratio - round(ratio)) < 1e-9 * ratio
