"""MAT files of versions 4 to 7.3, of which 7.3 is HDF5."""

import os
import zlib
from pathlib import Path
from typing import Any, Final, Literal

import h5py
import numpy as np

from leactl.errors import InputError
from leactl.regular import open_regular
from leactl.runfile.hdf5.opening import open_foreign, reading
from leactl.runfile.hdf5.tree import DEEPEST_FOREIGN, MOST_UNPACKED
from leactl.runfile.importing.sources.source import SourceRequest
from leactl.runfile.importing.sources.trees import TreeSource

ENDINGS = (".mat",)
MAT_HEADER: Final = 128  # bytes, of versions 5 to 7
MAT_PACKED: Final = 15  # an element of this type is a packed one
BLOCK: Final = 1 << 20  # bytes that are unpacked at once


def open_source(path: Path, request: SourceRequest) -> TreeSource:
    """Open a MAT file."""
    return TreeSource(path, mat_tree(path))


def mat_tree(path: Path) -> Any:
    """Variables of a MAT file as nested dicts, lists and arrays; version 7.3 is read as HDF5.

    Raises
    ------
    InputError : not a MAT file, or one cut short.
    """
    from scipy.io import loadmat

    try:
        if h5py.is_hdf5(path):
            tree = hdf5_tree(path)
        else:
            refuse_swelling(path)
            tree = loadmat(path, simplify_cells=True)
    # scipy meets a damaged file with whatever its parser stumbles over
    except (ValueError, TypeError, KeyError, IndexError, EOFError, NotImplementedError, MemoryError) as error:
        raise InputError(f"{path}: not a MAT file that can be read: {' '.join(str(error).split())}") from None
    return {name: value for name, value in tree.items() if not name.startswith(("__", "#"))}


def refuse_swelling(path: Path) -> None:
    """Refuse a MAT file of version 5 to 7 whose compressed variables exceed `MOST_UNPACKED`.

    The file is a sequence of elements with type and length; compressed ones are zlib streams (MATLAB, MAT-file format).

    Raises
    ------
    InputError : the variables are too large.
    """
    times, extra = MOST_UNPACKED
    with open_regular(path) as raw:
        size = os.fstat(raw.fileno()).st_size
        bytes_left = times * size + extra
        head = raw.read(MAT_HEADER)
        order: Literal["big", "little"] = "big" if head.endswith(b"MI") else "little"
        while len(tag := raw.read(8)) == 8 and int.from_bytes(tag[:4], order) == MAT_PACKED:
            packed = raw.read(int.from_bytes(tag[4:], order))
            deflate = zlib.decompressobj()
            while packed:
                try:
                    bytes_left -= len(deflate.decompress(packed, BLOCK))
                except zlib.error:
                    return  # damaged, as scipy will say
                packed = deflate.unconsumed_tail
                if bytes_left < 0:
                    raise InputError(f"{path}: unpacks to more than {times * size + extra} bytes; fewer were expected")


def hdf5_tree(path: Path) -> Any:
    """The variables of a MAT file of version 7.3."""
    with open_foreign(path) as file, reading(path):
        return _Referring(path, file).members(file, 0)


class _Referring:
    """Reader of a MAT file of version 7.3, whose cells are references; each object is read once."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file
        self._read: dict[int, Any] = {}  # by address

    def members(self, group: Any, depth: int) -> dict[str, Any]:
        """Members of a group by name."""
        return {name: self._value(child, depth) for name, child in group.items() if name != "#refs#"}

    def _value(self, node: Any, depth: int) -> Any:
        address = h5py.h5o.get_info(node.id).addr
        if address not in self._read:
            if depth == DEEPEST_FOREIGN:  # as where a cell refers to itself
                raise InputError(f"{self._path}: cells in more than {DEEPEST_FOREIGN} others; fewer were expected")
            self._read[address] = self._unread(node, depth + 1)
        return self._read[address]

    def _unread(self, node: Any, depth: int) -> Any:
        if isinstance(node, h5py.Group):
            return self.members(node, depth)
        if h5py.check_ref_dtype(node.dtype) is not None:  # cells and arrays of structs
            references = [reference for reference in node[()].reshape(-1) if reference]
            return [self._value(self._file[reference], depth) for reference in references]
        values = np.asarray(node[()]).T  # MATLAB counts columns first
        if node.attrs.get("MATLAB_class") == b"char":
            return values.astype("<u2").tobytes().decode("utf-16-le", "replace")
        return values
