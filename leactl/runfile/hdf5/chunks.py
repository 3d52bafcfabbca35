"""Check the decompressed sizes of chunks, since HDF5 decompresses a chunk to its end, whatever size is announced.

A chunk for which 8 KiB are announced may decompress to a thousand times its size in the file, and HDF5 keeps all of it
in memory as long as the dataset is open.
"""

import zlib
from typing import Any, Final

import h5py
import numpy as np

MOST_DEFLATE_RATIO: Final = 1032  # largest compression ratio of deflate (zlib's technical details)
CHECKSUM: Final = 4  # bytes of Fletcher's checksum, after the values
DEFLATE_OVERHEAD: Final = 1 << 12  # bytes, besides a thousandth, that deflate may add to incompressible values


def chunks(dataset: Any) -> list[Any]:
    """Return the chunk info of each written chunk: offset in the dataset, offset in the file, and stored size."""
    infos: list[Any] = []
    dataset.chunk_iter(infos.append)
    return infos


def exceeds_announced(dataset: Any, chunk: Any, announced_bytes: int) -> bool:
    """Return whether a compressed chunk takes, or decompresses to, more than the announced bytes; False if damaged."""
    if chunk.size > announced_bytes + announced_bytes // 1000 + DEFLATE_OVERHEAD:
        return True
    _, packed = dataset.read_direct_chunk(chunk.chunk_offset)
    try:
        return len(zlib.decompressobj().decompress(packed, announced_bytes + 1)) > announced_bytes
    except zlib.error:
        return False


def unpacked(dataset: Any, chunk: Any, announced_bytes: int, value_size: int) -> bytes | None:
    """Return the values of a chunk, decompressed; None if it is damaged or decompresses to more than announced."""
    values: bytes = dataset.read_direct_chunk(chunk.chunk_offset)[1]
    applied_filters = [
        code for bit, code in enumerate(filters(dataset.get_create_plist())) if not chunk.filter_mask >> bit & 1
    ]
    most_bytes = announced_bytes + CHECKSUM * (h5py.h5z.FILTER_FLETCHER32 in applied_filters)
    for code in reversed(applied_filters):
        if code == h5py.h5z.FILTER_FLETCHER32:
            values = values[:-CHECKSUM]
        elif code == h5py.h5z.FILTER_SHUFFLE:  # first bytes of all values, second bytes of all values ...
            rows = len(values) // value_size
            values = np.frombuffer(values, np.uint8, rows * value_size).reshape(value_size, rows).T.tobytes()
        else:
            try:
                values = zlib.decompressobj().decompress(values, most_bytes + 1)
            except zlib.error:
                return None
            if len(values) > most_bytes:
                return None
    return values


def last_value(dataset: Any) -> "np.ndarray[Any, Any]":
    """Return the last value of a one-dimensional dataset, as an array of length 1; of length 0 for an empty dataset.

    Raises
    ------
    OSError : the last chunk decompresses to more bytes than announced.
    """
    rows = len(dataset)
    if rows and dataset.chunks and h5py.h5z.FILTER_DEFLATE in filters(dataset.id.get_create_plist()):
        length = dataset.chunks[0]
        chunk = dataset.id.get_chunk_info_by_coord(((rows - 1) // length * length,))
        if chunk.size and exceeds_announced(dataset.id, chunk, length * dataset.dtype.itemsize):
            raise OSError(f"the last chunk of {dataset.name} unpacks to more than it announces")
    values: np.ndarray[Any, Any] = dataset[-1:]
    return values


def filters(plist: Any) -> tuple[int, ...]:
    """Return the HDF5 filter codes of a dataset's chunks, in the order in which they were applied."""
    return tuple(plist.get_filter(index)[0] for index in range(plist.get_nfilters()))
