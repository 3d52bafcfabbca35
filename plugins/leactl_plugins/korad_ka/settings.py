"""The six models with their ratings and names, and the settings of one supply: its load, the limits of its output."""

from typing import Annotated, Final, Literal, NamedTuple

from pydantic import Field, model_validator

from leactl.driver.contract import DriverSettings

STEP_V, STEP_A = 0.01, 0.001  # of the levels


class Rating(NamedTuple):
    """Highest voltage and current of one model."""

    voltage: float  # V
    current: float  # A


RATINGS: Final = {
    "KA3003P": Rating(30.0, 3.0),
    "KA3005P": Rating(30.0, 5.0),
    "KA3010P": Rating(30.0, 9.999),  # rated 10 A, which has no place in the five characters of an answer
    "KA6002P": Rating(60.0, 2.0),
    "KA6003P": Rating(60.0, 3.0),
    "KA6005P": Rating(60.0, 5.0),
}
SOLD_AS: Final = {  # answers to *IDN? by other makers, without blanks (sigrok wiki; libsigrok, korad-kaxxxxp)
    "VELLEMANPS3005D": "KA3005P",
    "VELLEMANLABPS3005D": "KA3005P",
    "TENMA72-2535": "KA3003P",
    "TENMA72-2540": "KA3005P",
    "TENMA72-2545": "KA6002P",
    "TENMA72-2550": "KA6003P",
    "RND320-KA3005P": "KA3005P",
}
# name and firmware of a supply that loses commands for longer than `pace_s` covers (libsigrok, pull request 210)
TOO_SLOW_FIRMWARE: Final = ("VELLEMANPS3005D", "1.3")


def model_of(name: str) -> str | None:
    """Return the model that reports this name; None if no model of this driver does."""
    name = name.replace(" ", "")
    model = name.removeprefix("KORAD")
    return model if model != name and model in RATINGS else SOLD_AS.get(name)


class KoradKaSettings(DriverSettings):
    """One supply at the end of a serial line."""

    model: Literal["KA3003P", "KA3005P", "KA3010P", "KA6002P", "KA6003P", "KA6005P"]
    feeds: Literal["leads", "bus"]  # two leads of the role's motor, or the drives' DC link
    voltage_limit_V: Annotated[float, Field(strict=True, ge=1, le=60, allow_inf_nan=False)]  # noqa: N815 (a unit keeps its letter)
    current_limit_A: Annotated[float, Field(strict=True, gt=0, le=10, allow_inf_nan=False)]  # noqa: N815
    off_voltage_V: Annotated[float, Field(strict=True, gt=0, le=0.9, allow_inf_nan=False)] = 0.5  # noqa: N815
    off_current_A: Annotated[float, Field(strict=True, gt=0, le=1, allow_inf_nan=False)] = 0.05  # noqa: N815
    period_s: Annotated[float, Field(strict=True, ge=0.02, le=60, allow_inf_nan=False)] = 0.5
    answer_s: Annotated[float, Field(strict=True, ge=0.1, le=5, allow_inf_nan=False)] = 0.2
    pace_s: Annotated[float, Field(strict=True, ge=0.03, le=0.07, allow_inf_nan=False)] = (
        0.06  # from command to command
    )

    @model_validator(mode="after")
    def _limits_within_rating(self) -> "KoradKaSettings":
        rating = self.rating
        for name, value, bound, unit in (
            ("voltage_limit_V", self.voltage_limit_V, rating.voltage, "V"),
            ("current_limit_A", self.current_limit_A, rating.current, "A"),
        ):
            if value > bound:
                raise ValueError(f"{name} {value:g} {unit}: a {self.model} is served up to {bound:g} {unit}")
        return self

    @property
    def rating(self) -> Rating:
        """Rating of the model in the settings."""
        return RATINGS[self.model]
