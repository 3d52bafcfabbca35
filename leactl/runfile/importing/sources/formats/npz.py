"""Read archives of NumPy arrays (`numpy.savez`); sizes are checked by the arrays' headers, and nothing is unpickled."""

import zipfile
import zlib
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from leactl.errors import InputError
from leactl.regular_files import open_regular
from leactl.runfile.hdf5.tree import MOST_UNPACKED
from leactl.runfile.importing.sources.source import SourceRequest, reason_text
from leactl.runfile.importing.sources.trees import MOST_COLUMNS, TreeSource, is_by_row

ENDINGS = (".npz",)
MOST_ARRAYS: Final = 1000  # of an archive
LONGEST_HEADER: Final = 10_000  # characters; NumPy's own bound of a header that it parses
HEADERS: Final = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
DAMAGE: Final = (zipfile.BadZipFile, zlib.error, ValueError, EOFError, NotImplementedError, RuntimeError, KeyError)


def open_source(path: Path, request: SourceRequest) -> TreeSource:
    """Open an archive of arrays; `q[2]` is the third column of a matrix `q`, or its third row (see `is_by_row`).

    Raises
    ------
    InputError : not an archive, an array of objects, or an archive that exceeds `MOST_UNPACKED`.
    """
    arrays: dict[str, Any] = {}
    with open_regular(path) as raw:
        try:
            with zipfile.ZipFile(raw) as archive:
                check_unpacked_size(path, archive, raw)
                for info in archive.infolist():
                    arrays[info.filename.removesuffix(".npy")] = read_array(path, archive, info)
        except DAMAGE as fault:
            raise InputError(f"{path}: not an NPZ archive that can be read: {reason_text(fault)}") from None
    return TreeSource(path, arrays | columns_of(arrays))


def columns_of(arrays: dict[str, Any]) -> dict[str, Any]:
    """Return the columns of matrices by names such as `q[2]`, except for matrices whose rows are channels."""
    matrices = {name: array for name, array in arrays.items() if np.ndim(array) == 2 and not is_by_row(array, arrays)}
    return {
        f"{name}[{index}]": array[:, index]
        for name, array in matrices.items()
        for index in range(array.shape[1])[:MOST_COLUMNS]
    }


def check_unpacked_size(path: Path, archive: zipfile.ZipFile, raw: BinaryIO) -> None:
    """Raise InputError if an archive has too many arrays or exceeds `MOST_UNPACKED`.

    Raises
    ------
    InputError : the archive is too large.
    """
    infos = archive.infolist()
    if len(infos) > MOST_ARRAYS:
        raise InputError(f"{path}: {len(infos)} arrays; at most {MOST_ARRAYS} were expected")
    size_factor, extra_bytes = MOST_UNPACKED
    size = raw.seek(0, 2)
    most_bytes = size_factor * size + extra_bytes
    if (unpacked_bytes := sum(info.file_size for info in infos)) > most_bytes:
        raise InputError(f"{path}: unpacks to {unpacked_bytes} bytes from {size}; at most {most_bytes} were expected")


def read_array(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Any:
    """Read an array of an archive; a one-dimensional array of text becomes a list of str.

    Raises
    ------
    InputError : an array of objects, or one whose stored size differs from its header.
    """
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        if version not in HEADERS:
            raise InputError(f"{path}: {info.filename}: version {version} of its header is not read")
        shape, is_fortran_order, dtype = HEADERS[version](member, max_header_size=LONGEST_HEADER)
        if dtype.hasobject:
            raise InputError(f"{path}: {info.filename}: an array of objects; numbers or text were expected")
        announced_bytes = int(np.prod(shape, dtype=object)) * dtype.itemsize
        if (stored_bytes := info.file_size - member.tell()) != announced_bytes:
            raise InputError(
                f"{path}: {info.filename}: its header says {announced_bytes} bytes; {stored_bytes} are stored"
            )
        flat = np.frombuffer(member.read(announced_bytes), dtype)
    array = flat.reshape(shape, order="F" if is_fortran_order else "C")
    return [str(text) for text in flat] if dtype.kind in "U" and array.ndim == 1 else array
