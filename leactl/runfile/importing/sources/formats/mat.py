"""Read MAT files of versions 4 to 7.3, of which 7.3 is HDF5.

In version 7.3, attributes of a dataset or group, such as `MATLAB_class`, state the type of an array. They are read as
by the open readers matio (`src/mat73.c`) and mat-io, since MathWorks describes no version after 7.
"""

import os
import zlib
from pathlib import Path
from typing import Any, Final, Literal

import h5py
import numpy as np

from leactl.errors import InputError
from leactl.regular_files import open_regular
from leactl.runfile.hdf5.opening import open_foreign, reading
from leactl.runfile.hdf5.tree import MOST_FOREIGN_LEVELS, MOST_UNPACKED
from leactl.runfile.importing.sources.source import SourceRequest
from leactl.runfile.importing.sources.trees import TreeSource, Undecoded

ENDINGS = (".mat",)
MAT_HEADER: Final = 128  # bytes, of versions 5 to 7
MAT_MATRIX, MAT_COMPRESSED = 14, 15  # types of an element: a variable, and a compressed variable
BLOCK_BYTES: Final = 1 << 20  # bytes that are decompressed at once


def open_source(path: Path, request: SourceRequest) -> TreeSource:
    """Open a MAT file."""
    return TreeSource(path, mat_tree(path))


def mat_tree(path: Path) -> Any:
    """Read the variables of a MAT file as nested dicts, lists and arrays; version 7.3 is read as HDF5.

    Raises
    ------
    InputError : the file is not a MAT file, or is cut short.
    """
    from scipy.io import loadmat

    try:
        if h5py.is_hdf5(path):
            tree = hdf5_tree(path)
        else:
            check_unpacked_size(path)
            tree = loadmat(path, simplify_cells=True)
    # scipy's parser raises any of these for a damaged file
    except (ValueError, TypeError, KeyError, IndexError, EOFError, NotImplementedError, MemoryError) as error:
        raise InputError(f"{path}: not a MAT file that can be read: {' '.join(str(error).split())}") from None
    except OSError as error:
        if error.errno is not None:  # from the system; scipy's parser raises OSError without errno at the file's end
            raise
        raise InputError(f"{path}: truncated: the file ends within a variable; copy it again") from None
    return {name: value for name, value in tree.items() if not name.startswith("__")}


def check_unpacked_size(path: Path) -> None:
    """Raise InputError if the compressed variables of a MAT file of version 5 to 7 exceed `MOST_UNPACKED`.

    The file is a sequence of elements with type and length; compressed ones are zlib streams (MATLAB, MAT-file format).

    Raises
    ------
    InputError : the variables are too large.
    """
    size_factor, extra_bytes = MOST_UNPACKED
    with open_regular(path) as raw:
        size = os.fstat(raw.fileno()).st_size
        bytes_left = size_factor * size + extra_bytes
        header = raw.read(MAT_HEADER)
        if 0 in header[:4]:
            return  # version 4, which compresses nothing
        order: Literal["big", "little"] = "little" if header.endswith(b"IM") else "big"  # as scipy takes other marks
        while len(tag := raw.read(8)) == 8:
            element_type, length = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
            if element_type == MAT_MATRIX:
                raw.seek(length, os.SEEK_CUR)
                continue
            if element_type != MAT_COMPRESSED:
                return  # damaged, as scipy will say
            compressed = raw.read(length)
            decompressor = zlib.decompressobj()
            while compressed:
                try:
                    bytes_left -= len(decompressor.decompress(compressed, BLOCK_BYTES))
                except zlib.error:
                    return  # damaged, as scipy will say
                compressed = decompressor.unconsumed_tail
                if bytes_left < 0:
                    raise InputError(
                        f"{path}: unpacks to more than {size_factor * size + extra_bytes} bytes; fewer were expected"
                    )


def hdf5_tree(path: Path) -> Any:
    """Return the variables of a MAT file of version 7.3."""
    with open_foreign(path) as file, reading(path):
        reader = _ReferenceReader(path, file)
        # "#refs#" has the values of cells, "#subsystem#" the parts of objects
        return {name: reader.value(child, 0) for name, child in file.items() if not name.startswith("#")}


class _ReferenceReader:
    """Reader of a MAT file of version 7.3, whose cells are references; each object is read once."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file
        self._read: dict[int, Any] = {}  # by address

    def value(self, node: Any, depth: int) -> Any:
        """Return the value of a dataset or group; `depth` is the number of structs and cells around it.

        Raises
        ------
        InputError : structs and cells are nested too deeply.
        """
        address = h5py.h5o.get_info(node.id).addr
        if address not in self._read:
            if depth == MOST_FOREIGN_LEVELS:  # as where a cell refers to itself
                raise InputError(f"{self._path}: cells in more than {MOST_FOREIGN_LEVELS} others; fewer were expected")
            self._read[address] = self._read_value(node, depth + 1)
        return self._read[address]

    def _read_value(self, node: Any, depth: int) -> Any:
        """Read the value of a dataset or group, by the attributes that state its MATLAB type."""
        kind = _attribute_text(node.attrs.get("MATLAB_class", b""))
        if "MATLAB_object_decode" in node.attrs:  # its numbers identify the object and are not its values
            return Undecoded(f"a MATLAB object ({kind}), which only MATLAB decodes (save its vectors as variables)")
        if "MATLAB_sparse" in node.attrs:
            return Undecoded("a sparse matrix (save full(...) of it)")
        if isinstance(node, h5py.Group):
            return self._struct(node, depth)
        if node.attrs.get("MATLAB_empty", 0):  # its numbers are the lengths of its dimensions
            return "" if kind == "char" else np.empty(0)
        if h5py.check_ref_dtype(node.dtype) is not None:
            return self._cells(node, depth)
        if node.dtype.names:
            return Undecoded("complex numbers (save real(...) and imag(...) of them)")
        values = np.asarray(node[()]).T  # MATLAB counts columns first
        if kind == "char":
            rows = [row.tobytes().decode("utf-16-le", "replace") for row in np.atleast_2d(values.astype("<u2"))]
            return rows[0] if len(rows) == 1 else [row.rstrip() for row in rows]
        return values

    def _struct(self, group: Any, depth: int) -> Any:
        """Return a struct by field; for an array of structs, whose fields are references, a list of structs."""
        fields = dict(group.items())
        are_cells = [_holds_references(child) and "MATLAB_class" not in child.attrs for child in fields.values()]
        if not fields or not all(are_cells):
            return {name: self.value(child, depth) for name, child in fields.items()}
        columns = [self._cells(child, depth) for child in fields.values()]
        return [dict(zip(fields, values, strict=True)) for values in zip(*columns, strict=True)]

    def _cells(self, dataset: Any, depth: int) -> list[Any]:
        """Return the values that a dataset refers to."""
        return [self.value(self._file[reference], depth) for reference in dataset[()].reshape(-1) if reference]


def _holds_references(node: Any) -> bool:
    """Return whether a node is a dataset of references."""
    return isinstance(node, h5py.Dataset) and h5py.check_ref_dtype(node.dtype) is not None


def _attribute_text(value: Any) -> str:
    """Return the text of an attribute."""
    return value.decode("ascii", "replace") if isinstance(value, bytes) else str(value)
