"""A recording that is still being written, or was left by a kill, as the closed file that it would be at this moment.

HDF5 opens such a file in its SWMR mode alone, and there it takes a checksum that does not hold for the writer's doing:
it waits for the writer to mend it, twice as long each time, for ever where a disk spoiled one byte. As a closed file a
spoiled one is an error at once, and what the writer has flushed is read alike: it never leaves a reference to what it
has not written before (HDF5, single-writer/multiple-reader mode).
"""

import io
import os
import struct
from typing import Any, BinaryIO, Final

from leactl.regular import read_at

SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
# superblock of version 3 (HDF5 file format 3.0, II.A): at byte 11 bit 0, a writer has the file open, and bit 2, it
# writes in SWMR mode; where the file ends, as the writer last said; and a checksum of all before it
VERSION_AT, FLAGS_AT, END_AT, CHECKSUM_AT, LENGTH = 8, 11, slice(28, 36), slice(44, 48), 48
OPEN_FOR_WRITE, SWMR_WRITE = 0x01, 0x04
WORD: Final = 0xFFFFFFFF
BLOCK: Final = struct.Struct("<3L")


class AsClosed(io.RawIOBase):
    """A file of HDF5's superblock version 3 whose first bytes say that nobody writes it and that it is whole."""

    def __init__(self, raw: BinaryIO) -> None:
        self._descriptor = os.dup(raw.fileno())
        self._at = 0

    def seekable(self) -> bool:
        """HDF5 goes to and fro."""
        return True

    def readable(self) -> bool:
        """HDF5 only reads."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a byte, counted from the start or from the end as it is now."""
        self._at = offset + (os.fstat(self._descriptor).st_size if whence == os.SEEK_END else 0)
        return self._at

    def tell(self) -> int:
        """Where the next byte is read."""
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Read from here; of the superblock what it would be."""
        view = memoryview(buffer).cast("B")
        data = read_at(self._descriptor, len(view), self._at)
        count = len(data)
        view[:count] = data
        if self._at < LENGTH:
            superblock = as_closed(read_at(self._descriptor, LENGTH, 0), os.fstat(self._descriptor).st_size)
            superblock = superblock[self._at : self._at + count]
            view[: len(superblock)] = superblock
        self._at += count
        return count

    def close(self) -> None:
        """Let go of the file; also when nobody refers to it any more."""
        if not self.closed:
            os.close(self._descriptor)
        super().close()


def as_closed(head: bytes, size: int) -> bytes:
    """The superblock of a live file as that of a closed one of this size; a spoiled one keeps a wrong checksum."""
    superblock = bytearray(head)
    superblock[FLAGS_AT] = 0
    superblock[END_AT] = size.to_bytes(8, "little")
    checksum_error = checksum(head[: CHECKSUM_AT.start]) ^ int.from_bytes(head[CHECKSUM_AT], "little")
    superblock[CHECKSUM_AT] = (checksum(bytes(superblock[: CHECKSUM_AT.start])) ^ checksum_error).to_bytes(4, "little")
    return bytes(superblock)


def checksum(data: bytes) -> int:
    """HDF5's checksum of metadata: Bob Jenkins' lookup3 (public domain), `hashlittle` with an initial value of 0."""
    a = b = c = (0xDEADBEEF + len(data)) & WORD
    for at in range(0, len(data), BLOCK.size):
        if at:
            for turn in (4, 6, 8, 16, 19, 4):
                a, b, c = b, (c + b) & WORD, ((a - c) & WORD) ^ rotated_left(c, turn)
        words = BLOCK.unpack(data[at : at + BLOCK.size].ljust(BLOCK.size, b"\0"))
        a, b, c = ((have + word) & WORD for have, word in zip((a, b, c), words, strict=True))
    for turn in (14, 11, 25, 16, 4, 14, 24):
        a, b, c = b, ((c ^ b) - rotated_left(b, turn)) & WORD, a
    return b


def rotated_left(word: int, bits: int) -> int:
    """A word of 32 bits rotated to the left."""
    return (word << bits | word >> (32 - bits)) & WORD
