"""Parse a supply's replies; a reply that does not have exactly the expected form is Unreadable."""

import re
from typing import NamedTuple

from leactl.driver.conversation import Unreadable

NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,3})?")
ERROR = re.compile(r'([+-]?\d{1,5}),\s*"(.*)"')
LOOSE_ERROR = re.compile(r"([+-]?\d{1,5})\s*[, ]\s*(.*)")
STATUS = re.compile(r"0[xX]([0-9a-fA-F]{1,4})")
OUTPUT_CONNECTIONS = {1: "independent", 2: "parallel", 3: "series"}  # by bits 2 and 3 of an SPD3303X's status
LARGEST_VALUE = 1e4  # V or A; SCPI-1999 volume 1, 7.2.1.4 and 7.2.1.5: 9.9E37 is infinity, 9.91E37 not a number
# highest credible reading over the rating, even with the protections at their highest level
HIGHEST_READING_OVER_RATING = 1.2
TRUE, FALSE = ("1", "ON", "YES"), ("0", "OFF", "NO")


class InstrumentIdentity(NamedTuple):
    """The four fields of `*IDN?` (IEEE 488.2, 10.14)."""

    maker: str
    model: str
    serial_number: str
    revision: str


class ErrorEntry(NamedTuple):
    """One entry of the instrument's error queue; number 0 means that the queue is empty."""

    number: int
    text: str


def parse_level(line: bytes) -> float:
    """Parse a set level [V or A].

    Raises
    ------
    Unreadable : not a number, or above `LARGEST_VALUE`.
    """
    text = _text(line)
    if not NUMBER.fullmatch(text) or not abs(float(text)) <= LARGEST_VALUE:
        raise Unreadable(f"{text!r} where a number was expected")
    return float(text)


def parse_reading(line: bytes, form: re.Pattern[str], rating: float) -> float:
    """Parse a measured voltage or current [V or A] strictly, because a part of a reply may be a number as well.

    Raises
    ------
    Unreadable : not exactly in the family's form, or far above the rating of the model.
    """
    text = _text(line)
    if not form.fullmatch(text):
        raise Unreadable(f"{text!r} where a reading was expected")
    value = float(text)
    if not abs(value) <= min(HIGHEST_READING_OVER_RATING * rating, LARGEST_VALUE):
        raise Unreadable(f"{value:g} where no more than {rating:g} can be")
    return value


def parse_boolean(line: bytes) -> bool:
    """Parse a boolean.

    Raises
    ------
    Unreadable : the reply is none of the words for true and false.
    """
    text = _text(line).upper()
    if text not in TRUE + FALSE:
        raise Unreadable(f"{text!r} where 0 or 1 was expected")
    return text in TRUE


def parse_register(line: bytes) -> int:
    """Parse the value of a status register.

    Raises
    ------
    Unreadable : not a whole number from 0 to 65535.
    """
    text = _text(line)
    if not re.fullmatch(r"\+?\d{1,5}", text) or int(text) > 0xFFFF:
        raise Unreadable(f"{text!r} where a register was expected")
    return int(text)


def parse_regulation(line: bytes) -> int:
    """Parse how one of several outputs regulates: the two lowest bits of its condition register, 1 current, 2 voltage.

    Higher bits report the protections, which the driver queries by name.

    Raises
    ------
    Unreadable : not a whole number from 0 to 65535.
    """
    return parse_register(line) & 0b11


def parse_word(line: bytes) -> str:
    """Parse one word or number without its quotes, in capitals.

    Raises
    ------
    Unreadable : the reply is not one word of up to 20 letters, digits and commas.
    """
    text = _text(line).strip('"').upper()
    if not re.fullmatch(r"[A-Z0-9,]{1,20}", text):
        raise Unreadable(f"{text!r} where a word was expected")
    return text


def parse_status_on(line: bytes, output: int) -> bool:
    """Parse the status of an SPD3303X; return whether output 1 or 2 is on.

    Raises
    ------
    Unreadable : not a hexadecimal number, or one without a valid connection of the outputs.
    """
    return bool(_status(line) >> (output + 3) & 1)


def parse_status_regulation(line: bytes, output: int) -> int:
    """Parse the status of an SPD3303X; return what output 1 or 2 regulates: 1 current, 2 voltage, as in other families.

    Raises
    ------
    Unreadable : not a hexadecimal number, or one without a valid connection of the outputs.
    """
    return 1 if _status(line) >> (output - 1) & 1 else 2


def parse_status_outputs(line: bytes) -> str:
    """Parse the status of an SPD3303X; return how its outputs are connected: independent, parallel or series.

    Raises
    ------
    Unreadable : not a hexadecimal number, or one without a valid connection of the outputs.
    """
    return OUTPUT_CONNECTIONS[_status(line) >> 2 & 0b11]


def _status(line: bytes) -> int:
    """Parse the status word of an SPD3303X; raise Unreadable if it is not one."""
    text = _text(line)
    match = STATUS.fullmatch(text)
    # a connection of 0 does not exist: a digit was lost
    if match is None or int(match[1], 16) >> 2 & 0b11 not in OUTPUT_CONNECTIONS:
        raise Unreadable(f"{text!r} where a hexadecimal status was expected")
    return int(match[1], 16)


def parse_error_entry(line: bytes) -> ErrorEntry:
    """Parse an entry of the error queue.

    Raises
    ------
    Unreadable : not a number with a quoted text.
    """
    text = _text(line)
    match = ERROR.fullmatch(text)
    if match is None:
        raise Unreadable(f"{text!r} where an error entry was expected")
    return ErrorEntry(int(match[1]), match[2])


def parse_loose_error_entry(line: bytes) -> ErrorEntry:
    """Parse an entry of an error queue that quotes no text and may separate it by blanks: `0  No Error`.

    Raises
    ------
    Unreadable : not a number with a text.
    """
    text = _text(line)
    match = LOOSE_ERROR.fullmatch(text)
    if match is None or not re.search("[A-Za-z]", match[2]):  # `0 5` or `0,3.1` answers another query
        raise Unreadable(f"{text!r} where an error entry was expected")
    return ErrorEntry(int(match[1]), match[2].strip('"'))


def parse_identity(line: bytes) -> InstrumentIdentity:
    """Parse the identity of the instrument; an SPD3303X has the version of its hardware behind the four fields.

    Raises
    ------
    Unreadable : neither four nor five fields.
    """
    fields = [field.strip() for field in _text(line).split(",")]
    if len(fields) not in (4, 5) or not fields[0] or not fields[1]:
        raise Unreadable(f"{_text(line)!r} where an identity of four fields was expected")
    return InstrumentIdentity(*fields[:4])


def _text(line: bytes) -> str:
    """Return a reply as text without blanks around it; raise Unreadable if it is not printable."""
    text = line.decode("ascii", "backslashreplace").strip(" ")
    if not text.isprintable():
        raise Unreadable(f"{text!r} where text was expected")
    return text
