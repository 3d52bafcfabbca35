"""A mapping of a YAML file with a closed set of keys: a key that it lacks is answered with the one that was meant."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, ModelWrapValidatorHandler, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from leactl.yamlfile import AT_ODDS, NOT_A_MAPPING, UNKNOWN_KEY, Location

MOST_GUESSES = 20  # unknown keys of one block for which the one that was meant is looked for
LONGEST_GUESS = 80  # characters of a key that is compared


class Block(BaseModel):
    """A mapping with a closed set of keys; frozen once it is read."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    guesses: ClassVar[Mapping[str, str]] = {}  # keys that people write, and those that they mean

    @model_validator(mode="wrap")
    @classmethod
    def _name_what_was_expected(cls, given: Any, build: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return build(given)
        except ValidationError as error:
            meant = cls._meant(given)
            kept = [
                cls._reworded(item, meant)
                for item in error.errors(include_url=False)
                if not (item["type"] == "missing" and len(item["loc"]) == 1 and item["loc"][0] in meant.values())
            ]
            raise ValidationError.from_exception_data(cls.__name__, kept) from None

    @classmethod
    def faulty(cls, faults: Sequence[tuple[Location, str]]) -> ValidationError:
        """An error for a validator to raise, with the keys at fault where keys are at odds with one another."""
        items = [
            InitErrorDetails(type=PydanticCustomError(AT_ODDS, "{message}", {"message": message}), loc=keys, input=None)
            for keys, message in faults
        ]
        return ValidationError.from_exception_data(cls.__name__, items)

    @classmethod
    def _keys(cls) -> list[str]:
        """The keys as they stand in a file."""
        return [field.alias or name for name, field in cls.model_fields.items()]

    @classmethod
    def _meant(cls, given: Any) -> dict[str, str]:
        """The key that each unknown one probably stands for."""
        if not isinstance(given, Mapping):
            return {}
        known = cls._keys()
        unknown = [key for key in given if key not in known][:MOST_GUESSES]
        free = [key for key in known if key not in given]
        close = {key: get_close_matches(str(key)[:LONGEST_GUESS], free, n=1) for key in unknown}
        guessed = {key: cls.guesses[key] for key in unknown if key in cls.guesses}
        return {key: candidates[0] for key, candidates in close.items() if candidates} | guessed

    @classmethod
    def _reworded(cls, item: Any, meant: Mapping[str, str]) -> InitErrorDetails:
        kind, place, context = item["type"], item["loc"], item.get("ctx", {})
        if kind == "extra_forbidden" and len(place) == 1:
            expected = meant.get(place[0]) or "one of " + ", ".join(cls._keys())
            error: Any = PydanticCustomError(UNKNOWN_KEY, f"unknown key; {expected} was expected")
        elif kind == "model_type" and not place:
            error = PydanticCustomError(NOT_A_MAPPING, f"a mapping with keys of {', '.join(cls._keys())} was expected")
        elif kind in (UNKNOWN_KEY, NOT_A_MAPPING, AT_ODDS):
            error = PydanticCustomError(kind, item["msg"])
        else:
            error = kind
        return InitErrorDetails(type=error, loc=place, input=item["input"], ctx=context)
