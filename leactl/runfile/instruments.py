"""Define the facts about an instrument that a bench file or a mapping may state: identity and calibration dates."""

import re
from datetime import date
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from leactl.yamlblock import Block

LONGEST_LINE = 200  # characters of a text that is to be on one line


def _iso_date_only(value: Any) -> Any:
    """Raise ValueError if a text or a number is not an ISO date; pydantic would read a number as seconds since 1970."""
    if isinstance(value, str) and not re.fullmatch(r"\d{4}-\d{2}-\d{2}", value, re.ASCII):
        raise ValueError("a date as 2026-01-31 was expected")
    if isinstance(value, int | float):
        raise ValueError("a date as 2026-01-31 was expected")  # noqa: TRY004 (pydantic passes TypeError on)
    return value


def _quoted_text_only(value: Any) -> Any:
    """Raise ValueError if the value is an unquoted number, whose leading zeros YAML drops."""
    if isinstance(value, int | float):
        raise ValueError(f'a text was expected: put it in quotes, "{value}"')  # noqa: TRY004 (as above)
    return value


Label = Annotated[str, BeforeValidator(_quoted_text_only), Field(max_length=LONGEST_LINE)]
Day = Annotated[date, BeforeValidator(_iso_date_only)]


class Instrument(Block):
    """Identity and calibration dates of an instrument, as far as they are stated."""

    model: Label = ""
    serial: Label = ""
    firmware: Label = ""
    calibrated: Day | None = None
    calibration_due: Day | None = None

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        """Raise ValueError if the calibration is due before it was made."""
        if self.calibrated and self.calibration_due and self.calibration_due < self.calibrated:
            raise ValueError(f"calibration_due {self.calibration_due} is before calibrated {self.calibrated}")
        return self

    @property
    def facts(self) -> dict[str, str]:
        """The stated facts as text, by their attribute names in the run file."""
        texts = {"model": self.model, "serial": self.serial, "firmware": self.firmware}
        days = {"calibrated": self.calibrated, "calibration_due": self.calibration_due}
        return {name: text for name, text in texts.items() if text} | {
            name: day.isoformat() for name, day in days.items() if day
        }
