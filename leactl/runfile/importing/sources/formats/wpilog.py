"""Read WPILib data logs (`.wpilog`): each entry is a topic with one field, `value`; stamps are microseconds.

After the public specification, WPILib Data Log File Format 1.0 (allwpilib, wpiutil/doc/datalog.adoc). WPILib's own
Python reader is not used because it neither reports a truncated file nor stops at the truncated record.
"""

import mmap
import os
import struct
from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

from leactl.errors import InputError
from leactl.regular_files import open_regular
from leactl.runfile.importing.column_names import units_named
from leactl.runfile.importing.sources.messages import Message, MessageSource, OpenLog, Topic
from leactl.runfile.importing.sources.source import SourceRequest

ENDINGS = (".wpilog",)
MAGIC: Final = b"WPILOG"
MAJOR: Final = 1
VALUE: Final = "value"  # name of an entry's only field
START, FINISH, SET_METADATA = range(3)  # kinds of control records, which are those of entry 0
LATEST_US: Final = 1 << 53  # 285 years
LONGEST_TEXT: Final = 1 << 20  # bytes, of a name, a type or metadata
NUMBERS: Final = {"boolean": "?", "int64": "q", "float": "f", "double": "d"}
TEXTS: Final = ("string", "json")


class WpiRecord(NamedTuple):
    """A record of the log, with the range of its payload in the file."""

    entry: int  # number; 0 for a control record
    stamp_us: int
    payload_offset: int  # first byte
    payload_end: int  # byte after the last


def open_source(path: Path, request: SourceRequest) -> MessageSource:
    """Open a WPILib data log.

    Raises
    ------
    InputError : the file is not a data log, of another major version, truncated or damaged.
    """
    with open_regular(path) as file, _mapped(path, file) as data:
        opened = WpiLog(path, data)
        return MessageSource(OpenLog(path, opened.topics, opened.messages), request)


def _mapped(path: Path, file: BinaryIO) -> mmap.mmap:
    """Map a file into memory.

    Raises
    ------
    InputError : the file is shorter than the signature of a log; an empty file cannot be mapped.
    """
    if os.fstat(file.fileno()).st_size < len(MAGIC):
        raise InputError(f"{path}: not a WPILib data log")
    return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


class WpiLog:
    """An open data log; each call of `messages` reads it from the beginning."""

    def __init__(self, path: Path, data: mmap.mmap | bytes) -> None:
        self._path, self._data = path, data
        self.topics: dict[str, Topic] = {}
        self._first = self._header()
        for record in self._records():
            if record.entry == 0 and data[record.payload_offset] == START:
                _, name, kind, metadata = self._started(record)
                self._announce(name, kind, metadata)

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the values of these entries, in the order of the file."""
        decoders: dict[int, tuple[str, Callable[[int, int], Any]]] = {}
        for record in self._records():
            if record.entry == 0:
                control = self._data[record.payload_offset]
                if control == START:
                    entry, name, kind, _ = self._started(record)
                    decoders.pop(entry, None)
                    if name in topics:
                        decoders[entry] = name, partial(self._decode, kind)
                elif control == FINISH:
                    decoders.pop(self._number(record.payload_offset + 1, 4, record.payload_end), None)
            elif record.entry in decoders:
                name, decode = decoders[record.entry]
                stamp_ns = record.stamp_us * 1000
                yield Message(name, stamp_ns, stamp_ns, partial(decode, record.payload_offset, record.payload_end))

    def _header(self) -> int:
        """Check the header, and return the byte at which the first record begins."""
        header = self._data[: len(MAGIC) + 6]
        if not header.startswith(MAGIC):
            raise InputError(f"{self._path}: not a WPILib data log")
        version, extra_size = struct.unpack_from("<HI", header.ljust(12, b"\0"), len(MAGIC))
        if version >> 8 != MAJOR:
            raise InputError(f"{self._path}: data log of version {version >> 8}.{version & 0xFF}; {MAJOR} is read")
        if len(header) + extra_size > len(self._data) or len(header) < len(MAGIC) + 6:
            raise InputError(f"{self._path}: truncated: it ends within its header")
        return len(header) + int(extra_size)

    def _records(self) -> Iterator[WpiRecord]:
        """Yield the records in the order of the file.

        Raises
        ------
        InputError : a record is damaged, or goes beyond the end of the file.
        """
        data, record_offset, end = self._data, self._first, len(self._data)
        while record_offset < end:
            length_bits = data[record_offset]
            entry_offset = record_offset + 1
            size_offset = entry_offset + (length_bits & 3) + 1
            stamp_offset = size_offset + (length_bits >> 2 & 3) + 1
            payload_offset = stamp_offset + (length_bits >> 4 & 7) + 1
            payload_end = payload_offset + int.from_bytes(data[size_offset:stamp_offset], "little")
            if payload_offset > end or payload_end > end:
                raise InputError(
                    f"{self._path}: truncated: the record at byte {record_offset} of {end} goes beyond the end"
                )
            entry = int.from_bytes(data[entry_offset:size_offset], "little")
            stamp_us = int.from_bytes(data[stamp_offset:payload_offset], "little")
            if length_bits & 0x80 or (entry == 0 and payload_offset == payload_end) or stamp_us > LATEST_US:
                raise InputError(f"{self._path}: damaged: no record begins at byte {record_offset}")
            yield WpiRecord(entry, stamp_us, payload_offset, payload_end)
            record_offset = payload_end

    def _started(self, record: WpiRecord) -> tuple[int, str, str, str]:
        """Return the number, name, type and metadata of an entry that a control record starts."""
        offset = record.payload_offset + 1
        entry = self._number(offset, 4, record.payload_end)
        texts, offset = [], offset + 4
        for _ in range(3):
            length = self._number(offset, 4, record.payload_end)
            if length > LONGEST_TEXT or offset + 4 + length > record.payload_end:
                raise InputError(f"{self._path}: damaged: a text at byte {offset} of {length} bytes")
            texts.append(self._data[offset + 4 : offset + 4 + length].decode("utf-8", "replace"))
            offset += 4 + length
        return entry, texts[0], texts[1], texts[2]

    def _number(self, offset: int, size: int, end: int) -> int:
        """Return the little-endian number of `size` bytes at an offset of a control record, which ends at `end`.

        Raises
        ------
        InputError : the record ends before.
        """
        if offset + size > end:
            raise InputError(f"{self._path}: damaged: a control record at byte {offset} is cut short")
        return int.from_bytes(self._data[offset : offset + size], "little")

    def _announce(self, name: str, kind: str, metadata: str) -> None:
        """Add the topic of an entry; an unknown type, or one that changes later, makes the topic unreadable."""
        known_topic = self.topics.get(name)
        reason = ""
        if kind.removesuffix("[]") not in NUMBERS and kind not in TEXTS:
            reason = f"is of type {kind}; {', '.join((*NUMBERS, *TEXTS))} or a list of numbers was expected"
        elif known_topic and known_topic.kind != kind:
            reason = f"is of type {known_topic.kind} first and of {kind} later"
        if not (known_topic and known_topic.unreadable):
            self.topics[name] = Topic(name, kind, reason, VALUE, units_named(metadata))

    def _decode(self, kind: str, start: int, end: int) -> dict[str, Any]:
        """Decode the payload of a record to a message with one field.

        Raises
        ------
        ValueError : a number has another length than its type.
        """
        payload = self._data[start:end]
        if kind in TEXTS:
            return {VALUE: payload.decode("utf-8", "replace")}
        code = NUMBERS[kind.removesuffix("[]")]
        values = [value for (value,) in struct.iter_unpack(f"<{code}", payload)]
        if kind.endswith("[]"):
            return {VALUE: values}
        if len(values) != 1:
            raise ValueError(f"{len(payload)} bytes of {kind}")
        return {VALUE: values[0]}
