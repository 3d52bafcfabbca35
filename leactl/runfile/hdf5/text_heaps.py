"""Check the heaps with a file's texts before HDF5 reads them, since a length of 0 in a heap makes HDF5 loop for ever.

A heap is a sequence of objects, each with its length. The last object, number 0, is the free space; its length includes
its header and is therefore never 0. HDF5 steps by these lengths without a check, and no checksum covers a heap (HDF5
file format 3.0, III.E). HDF5 itself reports other faults of a heap. The length of the longest text bounds the memory
that many references to one text can take.
"""

import struct
from collections.abc import Iterator
from typing import BinaryIO, Final

from leactl.errors import InputError

HEAD: Final = b"GCOL\x01\0\0\0"  # signature, version and reserved bytes; the heap's length follows
HEADER: Final = struct.Struct("<8sQ")  # head and length of the heap
OBJECT: Final = struct.Struct("<HHLQ")  # number, references, reserved, length of the value after this header
ALIGNMENT: Final = 8  # bytes, of the objects in a heap
SEARCH_BYTES: Final = 1 << 22  # bytes that are searched at once
LONGEST_TEXT_BYTES: Final = 1 << 24  # of one text; HDF5 and Python briefly hold five copies of it
MOST_HEAP_OBJECTS: Final = 1 << 19  # heaps and their objects; a run has some hundred texts, and three for each event


def longest_text(stream: BinaryIO) -> int:
    """Return the length [bytes] of the longest text in the heaps of an HDF5 file with 8-byte lengths.

    Raises
    ------
    InputError : HDF5 would never reach the end of a heap, or there are more or longer texts than a run can have.
    """
    longest = object_count = 0
    for heap_offset in heaps(stream):
        for number, length in objects(stream, heap_offset):
            object_count += 1
            if not number and not length:
                raise InputError(f"damaged: the texts that begin at byte {heap_offset} are not whole")
            if object_count > MOST_HEAP_OBJECTS:
                raise InputError(f"more than {MOST_HEAP_OBJECTS} texts; fewer were expected of a run")
            longest = max(longest, length if number else 0)
            if longest > LONGEST_TEXT_BYTES:
                raise InputError(f"a text of {longest} bytes; at most {LONGEST_TEXT_BYTES} were expected")
    return longest


def heaps(stream: BinaryIO) -> Iterator[int]:
    """Yield the byte offsets of the heaps of a file, read block by block, since it may be larger than the memory."""
    block_offset, block = 0, bytes_at(stream, 0, SEARCH_BYTES)
    while len(block) >= len(HEAD):
        head_offset = block.find(HEAD)
        while head_offset >= 0:
            yield block_offset + head_offset
            head_offset = block.find(HEAD, head_offset + len(HEAD))
        block_offset += len(block) - len(HEAD) + 1  # a head may lie across two blocks
        block = bytes_at(stream, block_offset, SEARCH_BYTES)


def objects(stream: BinaryIO, offset: int) -> Iterator[tuple[int, int]]:
    """Yield number and length [bytes] of each object of the heap at byte `offset`, after (1, 0) for the heap itself."""
    yield 1, 0
    header_bytes = bytes_at(stream, offset, HEADER.size)
    if len(header_bytes) < HEADER.size:
        return
    end = offset + HEADER.unpack(header_bytes)[1]
    offset += HEADER.size
    while offset + OBJECT.size <= end and len(header_bytes := bytes_at(stream, offset, OBJECT.size)) == OBJECT.size:
        number, _, _, length = OBJECT.unpack(header_bytes)
        yield number, length
        offset += length if not number else OBJECT.size + -(-length // ALIGNMENT) * ALIGNMENT


def bytes_at(stream: BinaryIO, offset: int, count: int) -> bytes:
    """Read `count` bytes of a file from byte `offset`; fewer at the end of the file."""
    stream.seek(offset)
    return stream.read(count)
