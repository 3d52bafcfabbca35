"""Frames of mjbots' multiplex protocol, from the host's side: subframes that write, read and answer registers.

Source: mjbots, `docs/protocol/can.md` of the moteus repository and `mjlib/multiplex/format.h`.
"""

import math
import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

from leactl_plugins.moteus_can.registers import KNOWN_REGISTERS, SCALES

WRITE, READ, REPLY = 0x00, 0x10, 0x20  # bits 2 and 3: resolution; bits 0 and 1: number of registers up to 3
WRITE_ERROR, READ_ERROR = 0x30, 0x31
TEXT_TO_DEVICE, TEXT_TO_HOST, POLL_FOR_TEXT = 0x40, 0x41, 0x42
NOP = 0x50
LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # bytes of a CAN-FD frame
MOST_FRAME_BYTES = LENGTHS[-1]
MOST_VARUINT_BYTES = 5
REPLY_REQUESTED = 0x80  # bit of a frame's source


class Resolution(IntEnum):
    """Layout of a register's value in a frame."""

    INT8 = 0
    INT16 = 1
    INT32 = 2
    FLOAT = 3


LAYOUTS = tuple(struct.Struct(form) for form in ("<b", "<h", "<i", "<f"))  # by resolution
NAN_CODES = (-128, -32768, -2147483648)  # codes of a physical value that is NaN, by resolution


class ControllerReply(NamedTuple):
    """Content of one frame of a controller."""

    values: dict[int, float]  # by register, in the maker's units; NaN if the controller has no value
    errors: dict[int, int]  # by register, the code of the refusal
    text: bytes | None = None  # of the tunnel; None if the frame has no text


def identifier(source: int, destination: int) -> int:
    """Return the CAN identifier of a frame from a source to a destination."""
    return source << 8 | destination


def varuint(number: int) -> bytes:
    """Encode a non-negative integer in groups of seven bits, the least significant first."""
    encoded = bytearray()
    while number > 0x7F:
        encoded.append(number & 0x7F | 0x80)
        number >>= 7
    encoded.append(number)
    return bytes(encoded)


def write(register: int, values: Sequence[float], resolution: Resolution = Resolution.FLOAT) -> bytes:
    """Return a subframe that writes consecutive registers, in physical values of the maker's units.

    Raises
    ------
    ValueError : a value that the resolution cannot express; nothing is clipped.
    """
    codes = [_encode(register + number, value, resolution) for number, value in enumerate(values)]
    return _head(WRITE, register, len(values), resolution) + b"".join(codes)


def read(register: int, count: int = 1, resolution: Resolution = Resolution.FLOAT) -> bytes:
    """Return a subframe that queries consecutive registers."""
    return _head(READ, register, count, resolution)


def text_to_device(channel: int, text: bytes) -> bytes:
    """Return a subframe that sends text to the controller's tunnel."""
    return bytes((TEXT_TO_DEVICE,)) + varuint(channel) + varuint(len(text)) + text


def poll_for_text(channel: int, most_bytes: int) -> bytes:
    """Return a subframe that polls the controller's tunnel for at most `most_bytes` of text."""
    return bytes((POLL_FOR_TEXT,)) + varuint(channel) + varuint(most_bytes)


def pad(subframes: bytes) -> bytes:
    """Pad subframes to the next length of a CAN-FD frame.

    Raises
    ------
    ValueError : more than 64 bytes.
    """
    if len(subframes) > MOST_FRAME_BYTES:
        raise ValueError(f"{len(subframes)} bytes; {MOST_FRAME_BYTES} at the most were expected")
    length = next(length for length in LENGTHS if length >= len(subframes))
    return subframes.ljust(length, bytes((NOP,)))


def _head(kind: int, register: int, count: int, resolution: Resolution) -> bytes:
    """Return the head of a subframe for consecutive registers."""
    if 0 < count <= 3:
        return bytes((kind | resolution << 2 | count,)) + varuint(register)
    return bytes((kind | resolution << 2,)) + varuint(count) + varuint(register)


def _encode(register: int, value: float, resolution: Resolution) -> bytes:
    """Return the bytes of a value; raise ValueError if the resolution cannot express it."""
    if resolution is Resolution.FLOAT:
        try:
            return LAYOUTS[resolution].pack(value)
        except OverflowError:
            raise ValueError(f"register 0x{register:03X}: {value:g} is beyond single precision") from None
    highest = (1 << 8 * LAYOUTS[resolution].size - 1) - 1
    scales = SCALES.get(register)
    if math.isnan(value) and scales:
        return LAYOUTS[resolution].pack(-highest - 1)
    counts = value / scales[resolution] if scales else value
    lowest = -highest if scales else -highest - 1  # the lowest code is that of NaN
    if not lowest - 0.5 < counts < highest + 0.5:
        raise ValueError(f"register 0x{register:03X}: {value:g} does not fit into {resolution.name.lower()}")
    return LAYOUTS[resolution].pack(round(counts))


def parse(data: bytes) -> ControllerReply:
    """Parse a controller's frame.

    Raises
    ------
    ValueError : the frame is not a controller's, holds a register twice or one of unknown scale, or an integer register
        holds a fraction; the whole frame is then unusable.
    """
    values: dict[int, float] = {}
    errors: dict[int, int] = {}
    text: bytes | None = None
    offset, end = 0, len(data)
    try:
        while offset < end:
            kind, offset = data[offset], offset + 1
            if kind == NOP:
                continue
            if kind & 0xF0 == REPLY:
                offset = _take_values(kind, data, offset, values)
            elif kind in (READ_ERROR, WRITE_ERROR):
                register, offset = _take_varuint(data, offset)
                errors[register], offset = _take_varuint(data, offset)
            elif kind == TEXT_TO_HOST and text is None:
                _channel, offset = _take_varuint(data, offset)  # only one channel is polled
                count, offset = _take_varuint(data, offset)
                text, offset = data[offset : offset + count], offset + count
            else:
                raise ValueError(f"has 0x{kind:02X} at byte {offset - 1}, where a controller's subframe was expected")
    except (IndexError, struct.error):
        offset = end + 1
    if offset > end:
        raise ValueError(f"ends within a subframe, at byte {end}")
    return ControllerReply(values, errors, text)


def _take_values(kind: int, data: bytes, offset: int, values: dict[int, float]) -> int:
    """Parse the values of a subframe, from the byte after its first one; return the offset after it."""
    resolution, count = kind >> 2 & 3, kind & 3
    if not count:
        count, offset = _take_varuint(data, offset)
    register, offset = _take_varuint(data, offset)
    if not count:
        raise ValueError(f"has no register in the subframe before byte {offset}")
    layout = LAYOUTS[resolution]
    for number in range(register, register + count):
        if number in values:
            raise ValueError(f"tells register 0x{number:03X} twice")
        (value,) = layout.unpack_from(data, offset)
        values[number] = _decode(number, value, resolution)
        offset += layout.size
    return offset


def _decode(register: int, value: float, resolution: int) -> float:
    """Return the physical value or integer for the code of a register; raise ValueError if its scale is not known."""
    if register not in KNOWN_REGISTERS:
        raise ValueError(f"tells register 0x{register:03X}, whose scale is not known here")
    scales = SCALES.get(register)
    if scales is None:
        if not float(value).is_integer():
            raise ValueError(f"tells {value:g} for register 0x{register:03X}, which holds whole numbers")
        return float(value)
    if resolution == Resolution.FLOAT:
        return value
    return math.nan if value == NAN_CODES[resolution] else value * scales[resolution]


def _take_varuint(data: bytes, offset: int) -> tuple[int, int]:
    """Decode an integer; return it and the offset after it."""
    number = 0
    for count in range(MOST_VARUINT_BYTES):
        byte = data[offset + count]
        number |= (byte & 0x7F) << 7 * count
        if not byte & 0x80:
            return number, offset + count + 1
    raise ValueError(f"has a number of more than {MOST_VARUINT_BYTES} bytes before byte {offset + MOST_VARUINT_BYTES}")
