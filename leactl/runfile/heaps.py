"""Look through the heaps that hold a file's texts before HDF5 reads one: a blank in one keeps HDF5 busy for ever.

A heap is a row of objects, each with its length, and the last of them, number 0, is what is free: its length counts its
header too, so that it is never 0. HDF5 takes steps of these lengths without asking, and none of a heap's bytes is in a
checksum (HDF5 file format 3.0, III.E). What else may be wrong with a heap HDF5 finds itself.
"""

import struct
from collections.abc import Iterator
from typing import BinaryIO, Final

HEAD: Final = b"GCOL\x01\0\0\0"  # signature, version and what is reserved; the heap's length follows
HEADER: Final = struct.Struct("<8sQ")
OBJECT: Final = struct.Struct("<HHLQ")  # number, references, reserved, length of what follows
ALIGNMENT: Final = 8  # bytes, of the objects in a heap
BLOCK: Final = 1 << 22  # bytes, that are looked through at once
LENGTHS_AT: Final = 10  # of the superblock: how many bytes lengths have; other than 8 only where somebody asked for it


def endless_heaps(stream: BinaryIO) -> list[int]:
    """Where in an HDF5 file a heap lies that HDF5 would not come to the end of."""
    if bytes_at(stream, LENGTHS_AT, 1) != bytes([ALIGNMENT]):
        return []
    return [at for at in heaps(stream) if is_endless(stream, at)]


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


def is_endless(stream: BinaryIO, at: int) -> bool:
    """Whether a step from object to object of a heap is one of no length."""
    head = bytes_at(stream, at, HEADER.size)
    if len(head) < HEADER.size:
        return False
    end = at + HEADER.unpack(head)[1]
    at += HEADER.size
    while at + OBJECT.size <= end and len(head := bytes_at(stream, at, OBJECT.size)) == OBJECT.size:
        number, _, _, length = OBJECT.unpack(head)
        if not number and not length:
            return True
        at += length if not number else OBJECT.size + -(-length // ALIGNMENT) * ALIGNMENT
    return False


def bytes_at(stream: BinaryIO, at: int, count: int) -> bytes:
    """Bytes of a file, fewer where it ends before."""
    stream.seek(at)
    return stream.read(count)
