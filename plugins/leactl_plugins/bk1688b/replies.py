"""Parse a supply's replies: digits without a decimal point, then `OK`; anything else is Unreadable."""

import re
from collections.abc import Callable
from typing import NamedTuple, TypeVar

from leactl.driver.conversation import Unreadable

OK = b"OK"
Value = TypeVar("Value")


class LevelCounts(NamedTuple):
    """A voltage and a current as the supply sends them, in whole steps."""

    voltage_steps: int  # of 0.1 V
    current_steps: int  # of `SupplyRating.current_step`


class Display(NamedTuple):
    """Measured output, and which of voltage and current is regulated."""

    voltage: float  # V
    current: float  # A
    current_limited: bool  # True: constant current; False: constant voltage


def parse_confirmation(reply: bytes) -> None:
    """Check that a reply confirms a command.

    Raises
    ------
    Unreadable : anything but `OK`.
    """
    if reply != OK:
        raise Unreadable(f"{_reply_text(reply)} where OK was expected")


def parse_levels(reply: bytes) -> LevelCounts:
    """Parse a voltage and a current (settings or limits).

    Raises
    ------
    Unreadable : not six digits and `OK`.
    """
    match = re.fullmatch(rb"([0-9]{3})([0-9]{3})\nOK", reply)
    if match is None:
        raise Unreadable(f"{_reply_text(reply)} where six digits and OK were expected")
    return LevelCounts(int(match[1]), int(match[2]))


def parse_display(reply: bytes) -> Display:
    """Parse the measured voltage and current and the regulated quantity.

    Raises
    ------
    Unreadable : not nine digits, of which the last is 0 or 1, and `OK`.
    """
    match = re.fullmatch(rb"([0-9]{4})([0-9]{4})([01])\nOK", reply)
    if match is None:
        raise Unreadable(f"{_reply_text(reply)} where nine digits and OK were expected")
    return Display(int(match[1]) / 100, int(match[2]) / 100, match[3] == b"1")


def parser_of_last_lines(line_count: int, parse: Callable[[bytes], Value]) -> Callable[[bytes], Value]:
    """Return a parser of the last `line_count` lines of a reply.

    Earlier lines are the rest of an earlier reply that lacked its `OK`.
    """
    return lambda reply: parse(b"\n".join(reply.split(b"\n")[-line_count:]))


def _reply_text(reply: bytes) -> str:
    """Return a reply as text for a message."""
    return repr(reply.decode("ascii", "backslashreplace"))
