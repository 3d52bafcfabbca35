"""Source for nested names, lists and arrays, as JSON and MAT files hold them; columns are addressed by dotted paths."""

import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.runfile.importing.column_names import is_time
from leactl.runfile.importing.mapping import as_label
from leactl.runfile.importing.sources.source import ListedColumn, ListedTable, MissingColumn, as_float

Array = npt.NDArray[np.float64]
FEWEST_ROWS = 2  # of a table
MOST_COLUMNS = 64  # of a matrix whose columns are listed
MOST_ELEMENTS = 64  # of a list in each record, which are listed as columns
SURVEYED_ROWS = 200  # leading rows by which a column is judged to be numeric
LONGEST_PATH = 200  # characters; deeper nodes are not listed
_STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


@dataclass(frozen=True)
class Undecoded:
    """A node whose values cannot be read, with a description and advice for the user."""

    description: str


class TreeSource:
    """Source over a tree of dicts, lists and arrays."""

    remarks: Sequence[str] = ()

    def __init__(self, path: Path, tree: Any, began: datetime | None = None) -> None:
        self.path, self._tree, self.began = path, tree, began

    def column(self, name: str | int, records: str | None) -> Array | list[str]:
        """Return a column by its path, relative to `records` if given."""
        base = self._walk(self._tree, records) if records else self._tree
        node = self._indexed(base, name, records) if isinstance(name, int) else self._walk(base, name, is_column=True)
        return self._as_column(node, name)

    def labels(self, name: str | int, records: str | None) -> list[str]:
        """Return a column by path, as labels."""
        return [as_label(value) for value in self.column(name, records)]

    def field(self, name: str | int) -> float | str:
        """Return a single value by path."""
        value = self._walk(self._tree, str(name))
        if isinstance(value, np.ndarray) and value.size == 1:
            value = value.reshape(-1)[0].item()
        if isinstance(value, str):
            return value
        if isinstance(value, bool | int | float | np.number):
            return as_float(value)
        raise MissingColumn(f"{self.path}: {name!r} holds {_described(value)} where one value was expected")

    def location(self, name: str | int, row: int) -> str:
        """Return file, column and row (from 0) for messages."""
        return f"{self.path}: {name!r} row {row}"

    def tables(self) -> list[ListedTable]:
        """Return the tables of the tree: lists of records, matrices, and sibling columns of equal length.

        Raises
        ------
        InputError : there is none, but a node that cannot be decoded.
        """
        tables = list(_tables(self._tree, ""))
        if not tables and (undecoded := list(_undecoded(self._tree, ""))):
            raise InputError(f"{self.path}: no table of numbers; {undecoded[0]}")
        return tables

    def _indexed(self, base: Any, index: int, records: str | None) -> Any:
        """Return a column of a matrix by its index.

        Raises
        ------
        MissingColumn : the node is not a matrix, or has no such column.
        """
        location = records or "the file"
        if isinstance(base, np.ndarray) and base.ndim == 2 and 0 <= index < base.shape[1]:
            return base[:, index]
        if isinstance(base, list) and base and all(isinstance(row, list) and 0 <= index < len(row) for row in base):
            return [row[index] for row in base]
        raise MissingColumn(f"{self.path}: {location} has no column {index}; it is {_described(base)}")

    def _walk(self, node: Any, path: str, is_column: bool = False) -> Any:
        """Return the node at a path; the last index of a column selects one of a matrix with samples as rows."""
        parent: Any = None
        is_gathered = False  # whether the node holds one value for each of a list of records
        if _has_key(node, path):
            return self._child(node, path, "")
        steps = list(_STEP.finditer(path))
        position = 0
        while position < len(steps):
            keys = [path[steps[position].start() : step.end()] for step in steps[position:]]
            # the longest key that exists, since a name in the file may contain dots
            count = next((number for number in range(len(keys), 1, -1) if _has_key(node, keys[number - 1])), 1)
            is_index = count == 1 and steps[position][2] is not None
            key = int(steps[position][2]) if is_index else keys[count - 1]
            parent_path = path[: steps[position - 1].end()] if position else ""
            if is_column and isinstance(key, int) and position + 1 == len(steps) and _is_by_column(node, parent):
                return self._indexed(node, key, parent_path)
            gathers = isinstance(key, str) and isinstance(node, list)
            child_of = self._children if is_gathered else self._child
            parent, node = node, child_of(node, key, parent_path)
            is_gathered = is_gathered or gathers
            position += count
        return node

    def _child(self, node: Any, key: str | int, parent_path: str) -> Any:
        """Return the child of a node by its key or index; for a list of records, the values of the key in all of them.

        Raises
        ------
        MissingColumn : the node has no such child.
        """
        location = parent_path or "the file"
        if isinstance(key, int):
            has_rows = isinstance(node, list) or (isinstance(node, np.ndarray) and node.ndim > 0)
            if has_rows and key < len(node):
                return node[key]
            raise MissingColumn(f"{self.path}: {location} has no item {key}; it is {_described(node)}")
        if isinstance(node, dict):
            if key in node:
                return node[key]
            raise MissingColumn(
                f"{self.path}: {location} has no {key!r}; it has {', '.join(map(str, node)) or 'nothing'}"
            )
        if isinstance(node, list) and all(isinstance(item, dict) for item in node):
            if not any(key in item for item in node):
                keys_text = ", ".join(sorted({str(name) for item in node[:100] for name in item})) or "nothing"
                raise MissingColumn(f"{self.path}: no record of {location} has {key!r}; they have {keys_text}")
            return [item.get(key) for item in node]  # None for a record without this key
        raise MissingColumn(f"{self.path}: {location} has no {key!r}; it is {_described(node)}")

    def _children(self, nodes: list[Any], key: str | int, parent_path: str) -> list[Any]:
        """Return the child of each record's node by its key or index; None for a record without this child.

        Raises
        ------
        MissingColumn : no record has such a child.
        """
        values = [
            node.get(key)
            if isinstance(node, dict)
            else node[key]
            if isinstance(node, list) and isinstance(key, int) and key < len(node)
            else None
            for node in nodes
        ]
        if all(value is None for value in values):
            raise MissingColumn(f"{self.path}: {parent_path} has no {key!r} in any record; it is {_described(nodes)}")
        return values

    def _as_column(self, node: Any, name: str | int) -> Array | list[str]:
        """Convert a node to a column of numbers, or of texts if all its values are texts.

        Raises
        ------
        MissingColumn : the node is not a column.
        InputError : a value of the column is not a number.
        """
        if isinstance(node, np.ndarray) and node.dtype.kind in "fiub":
            flat = node.reshape(-1) if node.size == max(node.shape, default=0) else node
            if flat.ndim == 1:
                return flat.astype(np.float64)
        if isinstance(node, list) and node:
            if all(isinstance(value, str) for value in node):
                return node
            numbers = array("d")
            for row, value in enumerate(node):
                if value is not None and not isinstance(value, bool | int | float | np.number):
                    value_text = repr(value) if isinstance(value, str) else _described(value)
                    raise InputError(f"{self.location(name, row)}: {value_text} is not a number")
                try:
                    numbers.append(np.nan if value is None else as_float(value))
                except MissingColumn as error:
                    raise InputError(f"{self.location(name, row)}: {error}") from None
            return np.frombuffer(numbers, np.float64)
        raise MissingColumn(f"{self.path}: {name!r} holds {_described(node)} where a column of numbers was expected")


def _has_key(node: Any, key: str) -> bool:
    """Return whether a group, or any of a list of records, has this key."""
    if isinstance(node, list):
        return any(isinstance(item, dict) and key in item for item in node)
    return isinstance(node, dict) and key in node


def _is_by_column(value: Any, group: Any) -> bool:
    """Return whether a value is a matrix whose rows are samples: its group has a vector with one value for each row.

    In a matrix that is wider than long, such as 3 joints by 7 samples with a vector of 3 link lengths, rows are samples
    only if that vector contains stamps by its name.
    """
    if not isinstance(group, dict) or not _is_matrix(value):
        return False
    vectors = [name for name, member in group.items() if _is_column(member) and np.size(member) == len(value)]
    return bool(vectors) and (len(value) >= _width(value) or any(is_time(str(name)) for name in vectors))


def is_by_row(value: Any, group: dict[Any, Any]) -> bool:
    """Return whether a value is a matrix, wider than long, whose columns are samples: a vector has one for each."""
    if not _is_matrix(value) or len(value) >= _width(value) or _is_by_column(value, group):
        return False
    return any(_is_column(member) and np.size(member) == _width(value) for member in group.values())


def _width(matrix: Any) -> int:
    """Return the number of a matrix's columns."""
    return int(matrix.shape[1]) if isinstance(matrix, np.ndarray) else len(matrix[0])


def _is_matrix(value: Any) -> bool:
    """Return whether a value is a matrix of numbers."""
    if isinstance(value, np.ndarray):
        return value.ndim == 2 and value.dtype.kind in "fiub" and not _is_column(value)
    if not isinstance(value, list) or not all(isinstance(row, list) for row in value[:SURVEYED_ROWS]):
        return False
    widths = {len(row) for row in value[:SURVEYED_ROWS]}
    return len(widths) == 1 and widths != {0} and all(_is_number(cell) for row in value[:SURVEYED_ROWS] for cell in row)


def _described(value: Any) -> str:
    """Describe a node of the tree, for a message."""
    if isinstance(value, Undecoded):
        return value.description
    if isinstance(value, dict):
        return f"a group of {', '.join(map(str, value)) or 'nothing'}"
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} of {value.dtype}"
    return f"a list of {len(value)}" if isinstance(value, list) else f"{value!r}"[:60]


def _undecoded(node: Any, path: str) -> Iterator[str]:
    """Yield path and description of each node in nested groups that cannot be decoded."""
    for name, value in node.items() if isinstance(node, dict) else ():
        child_path = f"{path}.{name}" if path else str(name)
        if isinstance(value, Undecoded):
            yield f"{child_path} holds {value.description}"
        yield from _undecoded(value, child_path)


def _tables(node: Any, path: str) -> Iterator[ListedTable]:
    """Yield the tables at a node and below it."""
    records = path or None
    if isinstance(node, dict):
        by_length: dict[int, list[ListedColumn]] = {}
        for name, value in node.items():
            if _is_column(value):
                parent_array = node.get(str(name)[: -len("[0]")]) if str(name).endswith("[0]") else None
                if not _is_column(parent_array):  # else `q[0]` of an array of one column, which is listed as `q`
                    by_length.setdefault(np.size(value), []).append(ListedColumn(str(name)))
            elif _is_by_column(value, node) or is_by_row(value, node):
                channels, samples = _width(value), len(value)
                if is_by_row(value, node):
                    channels, samples = samples, channels
                names = [f"{name}[{index}]" for index in range(min(channels, MOST_COLUMNS))]
                new_columns = [ListedColumn(column) for column in names if column not in node]
                by_length.setdefault(samples, []).extend(new_columns)
            elif len(path) < LONGEST_PATH:
                yield from _tables(value, f"{path}.{name}" if path else str(name))
        for columns in by_length.values():
            yield ListedTable(records, tuple(columns))
    elif isinstance(node, list) and len(node) >= FEWEST_ROWS and all(isinstance(item, dict) for item in node):
        yield ListedTable(records, tuple(map(ListedColumn, _columns_of_records(node[:SURVEYED_ROWS], ""))))
    elif isinstance(node, np.ndarray) and node.ndim == 2 and node.dtype.kind in "fiub" and len(node) >= FEWEST_ROWS:
        yield ListedTable(records, tuple(map(ListedColumn, range(min(node.shape[1], MOST_COLUMNS)))))
    elif isinstance(node, list) and len(node) >= FEWEST_ROWS and all(isinstance(row, list) for row in node):
        width = min(len(row) for row in node)
        number_columns = [
            index for index in range(width) if all(_is_number(row[index]) for row in node[:SURVEYED_ROWS])
        ]
        yield ListedTable(records, tuple(map(ListedColumn, number_columns)))


def _columns_of_records(items: list[dict[str, Any]], path: str) -> Iterator[str]:
    """Yield the paths of the numbers in records, in their nested records, and in their lists of one length."""
    for name in dict.fromkeys(str(name) for item in items for name in item):
        values = [item.get(name) for item in items]
        child_path = f"{path}.{name}" if path else name
        if all(map(_is_number, values)):
            yield child_path
        elif all(isinstance(value, dict) for value in values) and len(child_path) < LONGEST_PATH:
            yield from _columns_of_records(values, child_path)  # type: ignore[arg-type]
        elif all(isinstance(value, list) and all(map(_is_number, value)) for value in values):
            lengths = {len(value) for value in values}  # type: ignore[arg-type]
            yield from (f"{child_path}[{index}]" for index in range(min(lengths)) if max(lengths) <= MOST_ELEMENTS)


def _is_column(value: Any) -> bool:
    """Return whether a value is a column of numbers."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "fiub" and value.size == max(value.shape, default=0) >= FEWEST_ROWS
    return isinstance(value, list) and len(value) >= FEWEST_ROWS and all(map(_is_number, value[:SURVEYED_ROWS]))


def _is_number(value: Any) -> bool:
    """Return whether a value may be in a column of numbers; None stands for a missing one."""
    return value is None or isinstance(value, bool | int | float | np.number)
