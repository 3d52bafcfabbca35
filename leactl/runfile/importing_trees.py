"""Files of nested names, lists and arrays, JSON and MAT (v4 to v7.3), as something to ask for columns and values."""

import json
import os
import re
import zlib
from array import array
from pathlib import Path
from typing import Any, Final, Literal

import h5py
import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.regular import open_regular
from leactl.runfile.importing_mapping import as_label
from leactl.runfile.opening import open_foreign, reading
from leactl.runfile.tree import DEEPEST_FOREIGN, MOST_UNPACKED

Array = npt.NDArray[np.float64]
MAX_JSON_BYTES = 1 << 30  # held in memory about five times over
MAT_HEADER: Final = 128  # bytes, of versions 5 to 7
MAT_PACKED: Final = 15  # an element of this type is a packed one
BLOCK: Final = 1 << 20  # bytes that are unpacked at once
_STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


class Lacking(Exception):
    """The source has no such column or field; the message says what it has."""


class TreeSource:
    """Nested names, lists and arrays."""

    def __init__(self, path: Path, tree: Any) -> None:
        self.path, self._tree = path, tree

    def column(self, name: str | int, records: str | None) -> Array | list[str]:
        """A column by path, below the records where they are given."""
        base = self._walk(self._tree, records) if records else self._tree
        found = self._indexed(base, name, records) if isinstance(name, int) else self._walk(base, name)
        return self._as_column(found, name)

    def labels(self, name: str | int, records: str | None) -> list[str]:
        """A column by path, as labels."""
        return [as_label(value) for value in self.column(name, records)]

    def field(self, name: str | int) -> float | str:
        """A single value by path."""
        value = self._walk(self._tree, str(name))
        if isinstance(value, np.ndarray) and value.size == 1:
            value = value.reshape(-1)[0].item()
        if isinstance(value, str):
            return value
        if isinstance(value, bool | int | float | np.number):
            return float(value)
        raise Lacking(f"{self.path}: {name!r} holds {_described(value)} where one value was expected")

    def place(self, name: str | int, row: int) -> str:
        """Name and row from 0."""
        return f"{self.path}: {name!r} row {row}"

    def _indexed(self, base: Any, index: int, records: str | None) -> Any:
        where = records or "the file"
        if isinstance(base, np.ndarray) and base.ndim == 2 and index < base.shape[1]:
            return base[:, index]
        if isinstance(base, list) and base and all(isinstance(row, list) and len(row) > index for row in base):
            return [row[index] for row in base]
        raise Lacking(f"{self.path}: {where} has no column {index}; it is {_described(base)}")

    def _walk(self, node: Any, path: str) -> Any:
        if isinstance(node, dict) and path in node:
            return node[path]
        done = ""
        for match in _STEP.finditer(path):
            key: str | int = match[1] if match[1] is not None else int(match[2])
            node = self._child(node, key, done)
            done = path[: match.end()]
        return node

    def _child(self, node: Any, key: str | int, done: str) -> Any:
        where = done or "the file"
        if isinstance(key, int):
            if isinstance(node, list | np.ndarray) and key < len(node):
                return node[key]
            raise Lacking(f"{self.path}: {where} has no item {key}; it is {_described(node)}")
        if isinstance(node, dict):
            if key in node:
                return node[key]
            raise Lacking(f"{self.path}: {where} has no {key!r}; it has {', '.join(map(str, node)) or 'nothing'}")
        if isinstance(node, list) and all(isinstance(item, dict) for item in node):
            if not any(key in item for item in node):
                has = ", ".join(sorted({str(k) for item in node[:100] for k in item})) or "nothing"
                raise Lacking(f"{self.path}: no record of {where} has {key!r}; they have {has}")
            return [item.get(key) for item in node]  # None: that record lacks it
        raise Lacking(f"{self.path}: {where} has no {key!r}; it is {_described(node)}")

    def _as_column(self, found: Any, name: str | int) -> Array | list[str]:
        if isinstance(found, np.ndarray) and found.dtype.kind in "fiub":
            flat = found.reshape(-1) if found.size == max(found.shape, default=0) else found
            if flat.ndim == 1:
                return flat.astype(np.float64)
        if isinstance(found, list) and found:
            if all(isinstance(value, str) for value in found):
                return found
            out = array("d")
            for row, value in enumerate(found):
                if value is not None and not isinstance(value, bool | int | float | np.number):
                    shown = repr(value) if isinstance(value, str) else _described(value)
                    raise InputError(f"{self.place(name, row)}: {shown} is not a number")
                out.append(np.nan if value is None else float(value))
            return np.frombuffer(out, np.float64)
        raise Lacking(f"{self.path}: {name!r} holds {_described(found)} where a column of numbers was expected")


def _described(value: Any) -> str:
    if isinstance(value, dict):
        return f"a group of {', '.join(map(str, value)) or 'nothing'}"
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} of {value.dtype}"
    return f"a list of {len(value)}" if isinstance(value, list) else f"{value!r}"[:60]


def json_tree(path: Path) -> Any:
    """The document of a JSON file; NaN may stand for what is missing.

    Raises
    ------
    InputError : too large, not UTF-8, or not JSON.
    """
    if (size := path.stat().st_size) > MAX_JSON_BYTES:
        raise InputError(f"{path}: {size} bytes of JSON; at most {MAX_JSON_BYTES} are read, use CSV or MAT")
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 at byte {error.start}") from None
    except json.JSONDecodeError as error:
        raise InputError(f"{path}:{error.lineno}:{error.colno}  not JSON: {error.msg}") from None
    except RecursionError:
        raise InputError(f"{path}: nested too deeply") from None


def mat_tree(path: Path) -> Any:
    """The variables of a MAT file as nested names; v7.3 is HDF5 and is read as such.

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
    """Refuse a MAT file of version 5 to 7 whose packed variables unpack to more than anybody looks at.

    It is a row of elements, each with its type and its length; a packed one is a zlib stream (MATLAB, MAT-file format).

    Raises
    ------
    InputError : it does.
    """
    times, beside = MOST_UNPACKED
    with open_regular(path) as raw:
        size = os.fstat(raw.fileno()).st_size
        left = times * size + beside
        head = raw.read(MAT_HEADER)
        order: Literal["big", "little"] = "big" if head.endswith(b"MI") else "little"
        while len(tag := raw.read(8)) == 8 and int.from_bytes(tag[:4], order) == MAT_PACKED:
            packed = raw.read(int.from_bytes(tag[4:], order))
            deflate = zlib.decompressobj()
            while packed:
                try:
                    left -= len(deflate.decompress(packed, BLOCK))
                except zlib.error:
                    return  # damaged, as scipy will say
                packed = deflate.unconsumed_tail
                if left < 0:
                    raise InputError(f"{path}: unpacks to more than {times * size + beside} bytes; fewer were expected")


def hdf5_tree(path: Path) -> Any:
    """The variables of a MAT file of version 7.3."""
    with open_foreign(path) as file, reading(path):
        return _Referring(path, file).members(file, 0)


class _Referring:
    """A MAT file of version 7.3, whose cells refer to their members: each is read once, however many refer to it."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file
        self._read: dict[int, Any] = {}  # by address

    def members(self, group: Any, depth: int) -> dict[str, Any]:
        """What a group holds, by name."""
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
