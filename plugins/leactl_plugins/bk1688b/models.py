"""The three models with their ratings and steps."""

from typing import Final, NamedTuple

from leactl_plugins.bk1688b.replies import LevelCounts

LEAST_V: Final = 1.0  # lowest voltage that can be set
STEP_V: Final = 0.1
RATED: Final = 0.15  # share of its rating by which a model's own limits may differ


class SupplyRating(NamedTuple):
    """Highest voltage and current of one model, and its step of current."""

    voltage: float  # V
    current: float  # A
    step_A: float  # noqa: N815 (a unit keeps its letter)


RATINGS: Final = {
    "1685B": SupplyRating(60.0, 5.0, 0.01),
    "1687B": SupplyRating(36.0, 10.0, 0.1),
    "1688B": SupplyRating(18.0, 20.0, 0.1),
}
HIGHEST: Final = max(rating.voltage for rating in RATINGS.values()), max(rating.current for rating in RATINGS.values())


def is_near(most: LevelCounts, rating: SupplyRating) -> bool:
    """Whether a supply that reports these limits can be of the model with this rating."""
    volts, amperes = most.volts * STEP_V, most.amperes * rating.step_A
    return abs(volts / rating.voltage - 1) < RATED and abs(amperes / rating.current - 1) < RATED
