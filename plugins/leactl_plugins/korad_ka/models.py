"""The six models with their ratings, and the names under which they answer."""

from typing import Final, NamedTuple

STEP_V, STEP_A = 0.01, 0.001


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
TOO_SLOW: Final = (
    "VELLEMANPS3005D",
    "1.3",
)  # loses commands for longer than the rest of them (libsigrok, pull request 210)


def model_of(name: str) -> str | None:
    """Model that reports this name; None for a name of no model of this driver."""
    name = name.replace(" ", "")
    model = name.removeprefix("KORAD")
    return model if model != name and model in RATINGS else SOLD_AS.get(name)
