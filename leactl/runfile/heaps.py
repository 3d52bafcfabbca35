"""Look through the heaps that hold a file's texts before HDF5 reads one: a blank in one keeps HDF5 busy for ever.

A heap is a row of objects, each with its length, and the last of them, number 0, is what is free: its length counts its
header too, so that it is never 0. HDF5 takes steps of these lengths without asking, and none of a heap's bytes is in a
checksum (HDF5 file format 3.0, III.E). What else may be wrong with a heap HDF5 finds itself.
"""

import mmap
import struct
from collections.abc import Iterator
from typing import BinaryIO, Final

HEAD: Final = b"GCOL\x01\0\0\0"  # signature, version and what is reserved; the heap's length follows
HEADER: Final = struct.Struct("<8sQ")
OBJECT: Final = struct.Struct("<HHLQ")  # number, references, reserved, length of what follows
ALIGNMENT: Final = 8  # bytes, of the objects in a heap
LENGTHS_AT: Final = 10  # of the superblock: how many bytes lengths have; other than 8 only where somebody asked for it


def endless_heaps(stream: BinaryIO) -> list[int]:
    """Where in an HDF5 file a heap lies that HDF5 would not come to the end of."""
    with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as raw:
        return [at for at in heaps(raw) if is_endless(raw, at)] if raw[LENGTHS_AT] == ALIGNMENT else []


def heaps(raw: mmap.mmap) -> Iterator[int]:
    """Where the heaps of a file begin."""
    at = raw.find(HEAD)
    while at >= 0:
        yield at
        at = raw.find(HEAD, at + len(HEAD))


def is_endless(raw: mmap.mmap, at: int) -> bool:
    """Whether a step from object to object of a heap is one of no length."""
    if at + HEADER.size > len(raw):
        return False
    _, length = HEADER.unpack_from(raw, at)
    end = min(at + length, len(raw))
    at += HEADER.size
    while at + OBJECT.size <= end:
        number, _, _, length = OBJECT.unpack_from(raw, at)
        if not number and not length:
            return True
        at += length if not number else OBJECT.size + -(-length // ALIGNMENT) * ALIGNMENT
    return False
