"""Settings of one supply: its model, its load, and the limits of its output."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from leactl.driver.contract import DriverSettings
from leactl_plugins.bk1688b.models import LEAST_V, RATINGS, SupplyRating

Least = Annotated[float, Field(strict=True, gt=0, le=1, allow_inf_nan=False)]


class Bk1688bSettings(DriverSettings):
    """One supply at the end of a serial line."""

    model: Literal["1685B", "1687B", "1688B"]
    feeds: Literal["leads", "bus"]  # two leads of the role's motor, or the drives' DC link
    voltage_limit_V: Annotated[float, Field(strict=True, ge=2 * LEAST_V, le=60, allow_inf_nan=False)]  # noqa: N815 (a unit keeps its letter)
    current_limit_A: Annotated[float, Field(strict=True, gt=0, le=20, allow_inf_nan=False)]  # noqa: N815
    off_voltage_V: Least = 0.5  # noqa: N815
    off_current_A: Least = 0.05  # noqa: N815
    period_s: Annotated[float, Field(strict=True, ge=0.02, le=60, allow_inf_nan=False)] = 0.2
    answer_s: Annotated[float, Field(strict=True, ge=0.05, le=5, allow_inf_nan=False)] = 0.3

    @model_validator(mode="after")
    def _within_the_model(self) -> "Bk1688bSettings":
        rating = self.rating
        for name, value, most, unit in (
            ("voltage_limit_V", self.voltage_limit_V, rating.voltage, "V"),
            ("current_limit_A", self.current_limit_A, rating.current, "A"),
        ):
            if value > most:
                raise ValueError(f"{name} {value:g} {unit}: a {self.model} is good for {most:g} {unit}")
        return self

    @property
    def rating(self) -> SupplyRating:
        """Rating of the model."""
        return RATINGS[self.model]
