"""Settings of one supply: its model, its load, and the limits of its output."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from leactl.driver.contract import DriverSettings
from leactl_plugins.korad_ka.models import RATINGS, Rating


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
    def _within_the_model(self) -> "KoradKaSettings":
        rating = self.rating
        for name, value, most, unit in (
            ("voltage_limit_V", self.voltage_limit_V, rating.voltage, "V"),
            ("current_limit_A", self.current_limit_A, rating.current, "A"),
        ):
            if value > most:
                raise ValueError(f"{name} {value:g} {unit}: a {self.model} is served up to {most:g} {unit}")
        return self

    @property
    def rating(self) -> Rating:
        """Rating of the model."""
        return RATINGS[self.model]
