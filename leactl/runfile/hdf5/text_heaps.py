"""Look through the heaps that hold a file's texts before HDF5 reads one: a blank in one keeps HDF5 busy for ever.

A heap is a row of objects, each with its length, and the last of them, number 0, is what is free: its length counts its
header too, so that it is never 0. HDF5 takes steps of these lengths without asking, and none of a heap's bytes is in a
checksum (HDF5 file format 3.0, III.E). What else may be wrong with a heap HDF5 finds itself. How long the longest text
is bounds what many references to one and the same text may swell to.
"""

import struct
from collections.abc import Iterator
from typing import BinaryIO, Final

from leactl.errors import InputError

HEAD: Final = b"GCOL\x01\0\0\0"  # signature, version and what is reserved; the heap's length follows
HEADER: Final = struct.Struct("<8sQ")
OBJECT: Final = struct.Struct("<HHLQ")  # number, references, reserved, length of what follows
ALIGNMENT: Final = 8  # bytes, of the objects in a heap
BLOCK: Final = 1 << 22  # bytes, that are looked through at once
MOST_BYTES: Final = 1 << 24  # of one text; HDF5 and Python hold five copies of it for a moment
MOST_STEPS: Final = 1 << 19  # heaps and the objects in them; a run has some hundred texts, and three for each event


def longest_text(stream: BinaryIO) -> int:
    """Bytes of the longest text in the heaps of an HDF5 file whose lengths have 8 bytes.

    Raises
    ------
    InputError : HDF5 would not come to the end of a heap, or there are more texts, or longer ones, than a run has.
    """
    longest = steps = 0
    for at in heaps(stream):
        for number, length in objects(stream, at):
            steps += 1
            if not number and not length:
                raise InputError(f"damaged: the texts that begin at byte {at} are not whole")
            if steps > MOST_STEPS:
                raise InputError(f"more than {MOST_STEPS} texts; fewer were expected of a run")
            longest = max(longest, length if number else 0)
            if longest > MOST_BYTES:
                raise InputError(f"a text of {longest} bytes; at most {MOST_BYTES} were expected")
    return longest


def heaps(stream: BinaryIO) -> Iterator[int]:
    """Where the heaps of a file begin; it is read block by block, for it may be larger than the memory."""
    begin, block = 0, bytes_at(stream, 0, BLOCK)
    while len(block) >= len(HEAD):
        at = block.find(HEAD)
        while at >= 0:
            yield begin + at
            at = block.find(HEAD, at + len(HEAD))
        begin += len(block) - len(HEAD) + 1  # a head may lie across two blocks
        block = bytes_at(stream, begin, BLOCK)


def objects(stream: BinaryIO, at: int) -> Iterator[tuple[int, int]]:
    """Number and length of each object of a heap, as far as HDF5 would step; the heap itself counts as a first one."""
    yield 1, 0
    head = bytes_at(stream, at, HEADER.size)
    if len(head) < HEADER.size:
        return
    end = at + HEADER.unpack(head)[1]
    at += HEADER.size
    while at + OBJECT.size <= end and len(head := bytes_at(stream, at, OBJECT.size)) == OBJECT.size:
        number, _, _, length = OBJECT.unpack(head)
        yield number, length
        at += length if not number else OBJECT.size + -(-length // ALIGNMENT) * ALIGNMENT


def bytes_at(stream: BinaryIO, at: int, count: int) -> bytes:
    """Bytes of a file, fewer where it ends before."""
    stream.seek(at)
    return stream.read(count)
