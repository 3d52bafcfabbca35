"""Read a recording that is still being written, or whose writer was killed, as if it had been closed just now.

HDF5 opens such a file only in its SWMR mode. In that mode, HDF5 takes a wrong checksum for an unfinished write and
waits for the writer to finish, twice as long each time, and for ever if the disk has damaged one byte. If the
superblock says "closed", a damaged byte is an error at once, and flushed data can still be read: the writer never
stores a reference before the data to which it refers (HDF5, single-writer/multiple-reader mode).
"""

import io
import os
import struct
from typing import Any, BinaryIO, Final

from leactl.regular_files import read_at

SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
# superblock of version 3 (HDF5 file format 3.0, II.A): flags at byte 11, bit 0 for a file that is open for writing and
# bit 2 for SWMR mode; the end of the file that the writer stored last; and a checksum of all bytes before it
VERSION_AT, FLAGS_AT, END_AT, CHECKSUM_AT, LENGTH = 8, 11, slice(28, 36), slice(44, 48), 48
OPEN_FOR_WRITE, SWMR_WRITE = 0x01, 0x04
WORD_MASK: Final = 0xFFFFFFFF
WORDS: Final = struct.Struct("<3L")


class AsClosed(io.RawIOBase):
    """File object that shows a live HDF5 file (superblock version 3) with the superblock of a closed one."""

    def __init__(self, raw: BinaryIO) -> None:
        self._descriptor = os.dup(raw.fileno())
        self._at = 0

    def seekable(self) -> bool:
        """Return True, since HDF5 seeks."""
        return True

    def readable(self) -> bool:
        """Return True, since HDF5 reads."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a byte, counted from the start, from the present position or from the present end of the file."""
        size = os.fstat(self._descriptor).st_size
        position = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: size}[whence]
        if position < 0:
            raise ValueError(f"seek to byte {position}")
        self._at = position
        return self._at

    def tell(self) -> int:
        """Return the position of the next byte."""
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Read bytes into a buffer; the superblock is that of a closed file."""
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
        """Close the file descriptor."""
        if not self.closed:
            os.close(self._descriptor)
        super().close()


def as_closed(live_superblock: bytes, size: int) -> bytes:
    """Convert the superblock of a live file to that of a closed file of `size` bytes; a wrong checksum stays wrong."""
    superblock = bytearray(live_superblock)
    superblock[FLAGS_AT] = 0
    superblock[END_AT] = size.to_bytes(8, "little")
    checksum_error = checksum(live_superblock[: CHECKSUM_AT.start]) ^ int.from_bytes(
        live_superblock[CHECKSUM_AT], "little"
    )
    superblock[CHECKSUM_AT] = (checksum(bytes(superblock[: CHECKSUM_AT.start])) ^ checksum_error).to_bytes(4, "little")
    return bytes(superblock)


def checksum(data: bytes) -> int:
    """Return HDF5's checksum of metadata: Bob Jenkins' lookup3 (public domain), `hashlittle` with initial value 0."""
    a = b = c = (0xDEADBEEF + len(data)) & WORD_MASK
    for offset in range(0, len(data), WORDS.size):
        if offset:
            for bits in (4, 6, 8, 16, 19, 4):
                a, b, c = b, (c + b) & WORD_MASK, ((a - c) & WORD_MASK) ^ rotated_left(c, bits)
        words = WORDS.unpack(data[offset : offset + WORDS.size].ljust(WORDS.size, b"\0"))
        a, b, c = ((state + word) & WORD_MASK for state, word in zip((a, b, c), words, strict=True))
    for bits in (14, 11, 25, 16, 4, 14, 24):
        a, b, c = b, ((c ^ b) - rotated_left(b, bits)) & WORD_MASK, a
    return b


def rotated_left(word: int, bits: int) -> int:
    """Rotate a word of 32 bits to the left."""
    return (word << bits | word >> (32 - bits)) & WORD_MASK
