"""Parse a supply's replies: digits without a decimal point, then `OK`; anything else is Unreadable."""

import re
from collections.abc import Callable
from typing import NamedTuple, TypeVar

from leactl.driver.conversation import Unreadable

OK = b"OK"
Value = TypeVar("Value")


class LevelCounts(NamedTuple):
    """Voltage in steps of 0.1 V, current in steps of the model."""

    volts: int
    amperes: int


class Display(NamedTuple):
    """Measured output, and which of voltage and current is regulated."""

    voltage: float  # V
    current: float  # A
    limited: bool  # True: constant current; False: constant voltage


def parse_done(answer: bytes) -> None:
    """Check the reply to a command.

    Raises
    ------
    Unreadable : anything but `OK`.
    """
    if answer != OK:
        raise Unreadable(f"{_shown(answer)} where OK was expected")


def parse_levels(answer: bytes) -> LevelCounts:
    """Parse two levels (settings or limits).

    Raises
    ------
    Unreadable : not six digits and `OK`.
    """
    match = re.fullmatch(rb"([0-9]{3})([0-9]{3})\nOK", answer)
    if match is None:
        raise Unreadable(f"{_shown(answer)} where six digits and OK were expected")
    return LevelCounts(int(match[1]), int(match[2]))


def parse_display(answer: bytes) -> Display:
    """Parse the display.

    Raises
    ------
    Unreadable : not nine digits, of which the last is 0 or 1, and `OK`.
    """
    match = re.fullmatch(rb"([0-9]{4})([0-9]{4})([01])\nOK", answer)
    if match is None:
        raise Unreadable(f"{_shown(answer)} where nine digits and OK were expected")
    return Display(int(match[1]) / 100, int(match[2]) / 100, match[3] == b"1")


def parse_last_line(lines: int, means: Callable[[bytes], Value]) -> Callable[[bytes], Value]:
    """Parse only the last lines of a reply: the end of an earlier reply without its `OK` may precede them."""
    return lambda answer: means(b"\n".join(answer.split(b"\n")[-lines:]))


def _shown(answer: bytes) -> str:
    return repr(answer.decode("ascii", "backslashreplace"))
