"""Parse a supply's answers, which have no end mark, no checksum and no echo; any other form is Unreadable."""

import re
from typing import NamedTuple

from leactl.driver.conversation import Unreadable

ON, CONSTANT_VOLTAGE = 0x40, 0x01


class SupplyStatus(NamedTuple):
    """The bits of the state on which all firmwares agree."""

    on: bool
    current_limited: bool  # True: constant current; False: constant voltage


class KoradIdentity(NamedTuple):
    """Name, firmware and serial number; empty where the answer has none."""

    name: str
    firmware: str
    serial_number: str


def parse_hundredths(answer: bytes) -> int:
    """Parse a voltage such as `12.34` to steps of 0.01 V.

    Raises
    ------
    Unreadable : the answer has another form.
    """
    match = re.fullmatch(rb"([0-9]{2})\.([0-9]{2})", answer)
    if match is None:
        raise Unreadable(f"{_answer_text(answer)} where a voltage such as 12.34 was expected")
    return int(match[1] + match[2])


def parse_thousandths(answer: bytes) -> int:
    """Parse a current such as `0.125` to steps of 0.001 A.

    Raises
    ------
    Unreadable : the answer has another form.
    """
    match = re.fullmatch(rb"([0-9])\.([0-9]{3})", answer)
    if match is None:
        raise Unreadable(f"{_answer_text(answer)} where a current such as 0.125 was expected")
    return int(match[1] + match[2])


def parse_set_thousandths(answer: bytes) -> int:
    """Parse a set current to steps of 0.001 A; some firmwares send a meaningless sixth byte after it.

    Raises
    ------
    Unreadable : the answer has another form.
    """
    return parse_thousandths(answer[:5] if len(answer) == 6 else answer)


def parse_status(answer: bytes) -> SupplyStatus:
    """Parse the one byte of the state.

    Raises
    ------
    Unreadable : more than one byte.
    """
    if len(answer) != 1:
        raise Unreadable(f"{_answer_text(answer)} where one byte was expected")
    return SupplyStatus(bool(answer[0] & ON), not answer[0] & CONSTANT_VOLTAGE)


def parse_identity(answer: bytes) -> KoradIdentity:
    """Parse name, firmware and serial number; some firmwares send a byte after them that is not text.

    Raises
    ------
    Unreadable : the answer has no name with a version.
    """
    match = re.fullmatch(rb"([ -~]+?) ?V([0-9]+\.[0-9]+)(?: SN:([0-9A-Za-z]+))?[^ -~]?", answer, re.DOTALL)
    if match is None:
        raise Unreadable(f"{_answer_text(answer)} where a name and a version such as KORADKA3005PV2.0 were expected")
    return KoradIdentity(*((text or b"").decode("ascii") for text in match.groups()))


def _answer_text(answer: bytes) -> str:
    """Return an answer as text for a message, in quotes."""
    return repr(answer)[1:]
