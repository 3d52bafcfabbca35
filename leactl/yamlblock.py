"""Models of YAML mappings with a closed set of keys; the fault of an unknown key names the key that was meant."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, ModelWrapValidatorHandler, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from leactl.yamlfile import AT_ODDS, NOT_A_MAPPING, UNKNOWN_KEY, Location

# bounds of the comparison of unknown keys with known ones, whose time grows with the number and the length of the keys
MOST_KEYS_COMPARED = 20  # unknown keys of one block
LONGEST_KEY_COMPARED = 80  # characters of a key that are compared


class Block(BaseModel):
    """Model of a mapping with a closed set of keys, frozen once it is read."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    guesses: ClassVar[Mapping[str, str]] = {}  # the key that is meant, by a wrong key that people write for it

    @model_validator(mode="wrap")
    @classmethod
    def _name_expected_keys(cls, value: Any, build: ModelWrapValidatorHandler[Self]) -> Self:
        """Build the model; an error on an unknown key replaces the error on the missing key that was meant."""
        try:
            return build(value)
        except ValidationError as error:
            likely_keys = cls._likely_keys(value)
            items = [
                cls._reworded(item, likely_keys)
                for item in error.errors(include_url=False)
                if not (item["type"] == "missing" and len(item["loc"]) == 1 and item["loc"][0] in likely_keys.values())
            ]
            raise ValidationError.from_exception_data(cls.__name__, items) from None

    @classmethod
    def faulty(cls, faults: Sequence[tuple[Location, str]]) -> ValidationError:
        """Return an error for a validator to raise if keys contradict each other, from locations and messages."""
        items = [
            InitErrorDetails(type=PydanticCustomError(AT_ODDS, "{message}", {"message": message}), loc=keys, input=None)
            for keys, message in faults
        ]
        return ValidationError.from_exception_data(cls.__name__, items)

    @classmethod
    def _keys(cls) -> list[str]:
        """Return the keys that a file may have."""
        return [field.alias or name for name, field in cls.model_fields.items()]

    @classmethod
    def _likely_keys(cls, value: Any) -> dict[str, str]:
        """Return, by unknown key, the absent known key that was probably meant."""
        if not isinstance(value, Mapping):
            return {}
        keys = cls._keys()
        unknown = [key for key in value if key not in keys][:MOST_KEYS_COMPARED]
        absent = [key for key in keys if key not in value]
        matches_by_key = {key: get_close_matches(str(key)[:LONGEST_KEY_COMPARED], absent, n=1) for key in unknown}
        guesses = {key: cls.guesses[key] for key in unknown if key in cls.guesses}
        return {key: candidates[0] for key, candidates in matches_by_key.items() if candidates} | guesses

    @classmethod
    def _reworded(cls, item: Any, likely_keys: Mapping[str, str]) -> InitErrorDetails:
        """Convert an item of a validation error to the details of a new error that names the expected keys."""
        error_type, location, context = item["type"], item["loc"], item.get("ctx", {})
        if error_type == "extra_forbidden" and len(location) == 1:
            expected = likely_keys.get(location[0]) or "one of " + ", ".join(cls._keys())
            error: Any = PydanticCustomError(UNKNOWN_KEY, f"unknown key; {expected} was expected")
        elif error_type == "model_type" and not location:
            error = PydanticCustomError(NOT_A_MAPPING, f"a mapping with keys of {', '.join(cls._keys())} was expected")
        elif error_type in (UNKNOWN_KEY, NOT_A_MAPPING, AT_ODDS):
            error = PydanticCustomError(error_type, item["msg"])
        else:
            error = error_type
        return InitErrorDetails(type=error, loc=location, input=item["input"], ctx=context)
