"""The three models with their ratings and steps, and the settings of one supply: its load, the limits of its output."""

from typing import Annotated, Final, Literal, NamedTuple

from pydantic import Field, model_validator

from leactl.driver.contract import DriverSettings
from leactl_plugins.bk1688b.replies import LevelCounts

LOWEST_VOLTAGE_V: Final = 1.0  # lowest voltage that can be set
STEP_V: Final = 0.1  # of voltage settings, in all models
RATING_TOLERANCE: Final = 0.15  # share of its rating by which the limits that a supply reports may differ


class SupplyRating(NamedTuple):
    """Highest voltage and current of one model, and its step of current."""

    voltage: float  # V
    current: float  # A
    current_step: float  # A


RATINGS: Final = {
    "1685B": SupplyRating(60.0, 5.0, 0.01),
    "1687B": SupplyRating(36.0, 10.0, 0.1),
    "1688B": SupplyRating(18.0, 20.0, 0.1),
}
HIGHEST_RATING: Final = (
    max(rating.voltage for rating in RATINGS.values()),
    max(rating.current for rating in RATINGS.values()),
)  # V, A


def can_be_model(reported_limits: LevelCounts, rating: SupplyRating) -> bool:
    """Return whether a supply that reports these limits can be of the model with this rating."""
    volts, amperes = reported_limits.voltage_steps * STEP_V, reported_limits.current_steps * rating.current_step
    return abs(volts / rating.voltage - 1) < RATING_TOLERANCE and abs(amperes / rating.current - 1) < RATING_TOLERANCE


OffThreshold = Annotated[float, Field(strict=True, gt=0, le=1, allow_inf_nan=False)]


class Bk1688bSettings(DriverSettings):
    """Settings of one supply on a serial line.

    The output counts as off up to both `off_` values. `period_s` is the time between readings, `answer_s` the longest
    time for a reply.
    """

    model: Literal["1685B", "1687B", "1688B"]
    feeds: Literal["leads", "bus"]  # two leads of the role's motor, or the drives' DC link
    # at least 2 V: a switched-off output is set to up to 1.9 V
    voltage_limit_V: Annotated[float, Field(strict=True, ge=2 * LOWEST_VOLTAGE_V, le=60, allow_inf_nan=False)]  # noqa: N815 (a unit keeps its letter)
    current_limit_A: Annotated[float, Field(strict=True, gt=0, le=20, allow_inf_nan=False)]  # noqa: N815
    off_voltage_V: OffThreshold = 0.5  # noqa: N815
    off_current_A: OffThreshold = 0.05  # noqa: N815
    period_s: Annotated[float, Field(strict=True, ge=0.02, le=60, allow_inf_nan=False)] = 0.2
    answer_s: Annotated[float, Field(strict=True, ge=0.05, le=5, allow_inf_nan=False)] = 0.3

    @model_validator(mode="after")
    def _limits_within_rating(self) -> "Bk1688bSettings":
        rating = self.rating
        for name, value, bound, unit in (
            ("voltage_limit_V", self.voltage_limit_V, rating.voltage, "V"),
            ("current_limit_A", self.current_limit_A, rating.current, "A"),
        ):
            if value > bound:
                raise ValueError(f"{name}: {value:g} {unit} is above the {bound:g} {unit} of a {self.model}; lower it")
        return self

    @property
    def rating(self) -> SupplyRating:
        """Rating of the model in the settings."""
        return RATINGS[self.model]
