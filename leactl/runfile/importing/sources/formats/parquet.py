"""Read Parquet tables by `pyarrow`; elements of lists are named `name[3]`, members of structs `a.b`.

Timestamps become seconds since the first of their column. Units, quantity, role and so on in the metadata of a field,
as `leactl runs export` writes them, are taken as declared by the file; so are the run's labels in that of the schema.
"""

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from leactl.errors import InputError
from leactl.quantities import ROLES, UNITS
from leactl.regular_files import open_regular
from leactl.runfile.hdf5.tree import MOST_UNPACKED
from leactl.runfile.importing.mapping import PLACEHOLDER
from leactl.runfile.importing.sources.source import ListedColumn, ListedTable, SourceRequest, reason_text
from leactl.runfile.importing.sources.trees import MOST_COLUMNS, TreeSource

ENDINGS = (".parquet", ".pq")
VALUE_BYTES: Final = 8  # of a number in memory
NANOSECONDS: Final = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}  # by the unit of a column of timestamps
MOST_INFO_BYTES: Final = 1 << 24  # of a dataset's `meta/info.json`
META_DEPTH: Final = 3  # folders above an episode of LeRobot to its dataset: data/chunk-000/episode_000000.parquet


class ParquetSource(TreeSource):
    """Source over a Parquet file, with the units and quantities that it declares."""

    def __init__(self, path: Path, tree: dict[str, Any], began: datetime | None, table: ListedTable) -> None:
        super().__init__(path, tree, began)
        self._table = table

    def tables(self) -> list[ListedTable]:
        """Return one table."""
        return [self._table]


def modules() -> tuple[Any, Any]:
    """Import `pyarrow` and `pyarrow.parquet`.

    Raises
    ------
    InputError : they are not installed, or cannot be loaded.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError as fault:
        raise InputError("Parquet needs pyarrow: pip install 'leactl[parquet]'") from fault
    except ImportError as fault:  # it is installed, but was built for another NumPy
        raise InputError(f"Parquet needs pyarrow, which cannot be loaded: {str(fault).splitlines()[0]}") from fault
    return pyarrow, parquet


def open_source(path: Path, request: SourceRequest) -> ParquetSource:
    """Open a Parquet file.

    Raises
    ------
    InputError : the file is not Parquet, damaged, or too large when decompressed, or pyarrow is missing.
    """
    arrow, parquet = modules()
    with open_regular(path) as raw, readable(path, arrow):
        file = parquet.ParquetFile(raw)
        names = [field.name for field in file.schema_arrow if asked_for(field.name, request)]
        check_unpacked_size(path, file.metadata, names)
        table = file.read(columns=names)
        while any(arrow.types.is_struct(field.type) for field in table.schema):
            table = table.flatten()
        names_by_column = joint_names(path)
        tree, listed, began = columns_of(table, arrow, names_by_column)
    joints = tuple(dict.fromkeys(joint for name in names if name in names_by_column for joint in names_by_column[name]))
    run = tuple(declared_run(texts_of(table.schema.metadata)))
    return ParquetSource(path, tree, began, ListedTable(None, tuple(listed), joints=joints, run=run))


@contextmanager
def readable(path: Path, arrow: Any) -> Iterator[None]:
    """Convert pyarrow's errors on a damaged file to an InputError of one line."""
    try:
        yield
    except (arrow.ArrowException, OSError, ValueError, MemoryError) as fault:
        if isinstance(fault, InputError):
            raise
        raise InputError(f"{path}: not a Parquet file that can be read: {reason_text(fault)}") from None


def asked_for(name: str, request: SourceRequest) -> bool:
    """Return whether a column, or an element of it, is wanted."""
    if request.columns is None:
        return True
    return any(str(wanted.name).startswith(name) for wanted in (*request.columns, *request.labels))


def check_unpacked_size(path: Path, metadata: Any, names: Iterable[str]) -> None:
    """Raise InputError if the columns exceed `MOST_UNPACKED`, since repeated values take almost no space in the file.

    Raises
    ------
    InputError : the columns are too large.
    """
    wanted, value_count = set(names), 0
    for group in range(metadata.num_row_groups):
        for index in range(metadata.num_columns):
            column = metadata.row_group(group).column(index)
            if column.path_in_schema.split(".")[0] in wanted or column.path_in_schema in wanted:
                value_count += max(column.num_values, 0)
    size_factor, extra_bytes = MOST_UNPACKED
    size = path.stat().st_size
    if VALUE_BYTES * value_count > size_factor * size + extra_bytes:
        most_values = (size_factor * size + extra_bytes) // VALUE_BYTES
        raise InputError(f"{path}: {value_count} values in a file of {size} bytes; at most {most_values} were expected")


def columns_of(
    table: Any, arrow: Any, elements: dict[str, list[str]]
) -> tuple[dict[str, Any], list[ListedColumn], datetime | None]:
    """Return the columns by name, their declarations, and the earliest timestamp of any column."""
    tree: dict[str, Any] = {}
    listed: list[ListedColumn] = []
    first_stamps = [
        first_stamp(column, field.type.unit, arrow)
        for field, column in zip(table.schema, table.columns, strict=True)
        if arrow.types.is_timestamp(field.type)
    ]
    known_stamps = [stamp for stamp in first_stamps if stamp is not None]
    origin_ns = min(known_stamps, default=0)  # one for all, or the time from one column to another is lost
    for field, column in zip(table.schema, table.columns, strict=True):
        kind, declared = field.type, declared_column(field.name, texts_of(field.metadata))
        if arrow.types.is_timestamp(kind):
            tree[field.name] = seconds(column, kind.unit, origin_ns, arrow)
            listed.append(ListedColumn(field.name, "s", "the type of its column"))
        elif arrow.types.is_string(kind) or arrow.types.is_large_string(kind) or arrow.types.is_dictionary(kind):
            tree[field.name] = texts(column)
        elif is_list(kind, arrow):
            columns = elements_of(column, arrow)
            names = elements.get(field.name, [])
            tree |= {f"{field.name}[{index}]": values for index, values in enumerate(columns)}
            if columns and len(names) == len(columns):
                tree |= {f"{field.name}[{name}]": values for name, values in zip(names, columns, strict=True)}
                listed.append(ListedColumn(f"{field.name}[{PLACEHOLDER}]"))
            else:
                listed += [ListedColumn(f"{field.name}[{index}]") for index in range(len(columns))]
        elif is_number(kind, arrow):
            tree[field.name] = column.cast(arrow.float64(), safe=False).to_numpy()
            listed.append(declared)
    return tree, listed, moment_of(origin_ns) if known_stamps else None


def texts_of(metadata: dict[bytes, bytes] | None) -> dict[str, str]:
    """Convert the metadata of a field or a schema to texts."""
    return {name.decode(): text.decode() for name, text in (metadata or {}).items()}


def declared_column(name: str, metadata: dict[str, str]) -> ListedColumn:
    """Return a column with what its metadata declares in the vocabulary of run files."""
    expected = {"quantity": UNITS, "role": ROLES, "sampling": ("instant", "mean")}
    declared = {key: metadata[key] for key, words in expected.items() if metadata.get(key) in words}
    declared |= {key: metadata[key] for key in ("location", "device") if key in metadata}
    units = metadata.get("units", "")
    return ListedColumn(name, units, "the file's metadata" if units or declared else "", **declared)


def declared_run(metadata: dict[str, str]) -> Iterator[tuple[str, str | bool]]:
    """Yield the labels of the run that a schema's metadata declares, and whether it was simulated."""
    if "run_id" not in metadata:
        return
    for name in ("protocol", "bench", "actuator", "condition", "operator", "created"):
        if metadata.get(name):
            yield name, metadata[name]
    if metadata.get("simulated", "").lower() in ("1", "true"):
        yield "simulated", True


def is_list(kind: Any, arrow: Any) -> bool:
    """Return whether a column holds lists of numbers."""
    lists = (arrow.types.is_list, arrow.types.is_large_list, arrow.types.is_fixed_size_list)
    return any(test(kind) for test in lists) and is_number(kind.value_type, arrow)


def is_number(kind: Any, arrow: Any) -> bool:
    """Return whether a column holds numbers or booleans; dates and durations are none."""
    types = arrow.types
    return any(test(kind) for test in (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal))


def elements_of(column: Any, arrow: Any) -> list[Any]:
    """Return a column for each element of lists of equal length; empty if the lengths differ."""
    rows = len(column)
    values = arrow.chunked_array([chunk.flatten() for chunk in column.chunks], column.type.value_type)
    if not rows or column.null_count or len(values) % rows or not 0 < len(values) // rows <= MOST_COLUMNS:
        return []
    width = len(values) // rows
    if any(length != width for chunk in column.chunks for length in lengths(chunk)):
        return []
    matrix = values.cast(arrow.float64(), safe=False).to_numpy().reshape(rows, width)
    return [matrix[:, index] for index in range(width)]


def lengths(chunk: Any) -> Any:
    """Return the distinct lengths of the lists of a chunk."""
    return [chunk.type.list_size] if hasattr(chunk.type, "list_size") else np.unique(np.diff(chunk.offsets.to_numpy()))


def first_stamp(column: Any, unit: str, arrow: Any) -> int | None:
    """Return the first of a column of timestamps [ns]; None if it has none."""
    counts = column.cast(arrow.int64()).drop_null()
    return int(counts[0].as_py()) * NANOSECONDS[unit] if len(counts) else None


def seconds(column: Any, unit: str, origin_ns: int, arrow: Any) -> Any:
    """Convert timestamps to seconds since an origin [ns]; a null is NaN."""
    counts = column.cast(arrow.int64()).to_pylist()
    return np.array(
        [np.nan if count is None else (count * NANOSECONDS[unit] - origin_ns) / NANOSECONDS["s"] for count in counts]
    )


def moment_of(stamp_ns: int) -> datetime | None:
    """Return the moment of a stamp [ns]; None if it is beyond any calendar."""
    try:
        return datetime.fromtimestamp(stamp_ns / NANOSECONDS["s"], UTC)
    except (OverflowError, ValueError, OSError):
        return None


def texts(column: Any) -> list[str]:
    """Return a column of text; equal texts share one str object, since few occur in millions of rows."""
    encoded = column if hasattr(column.type, "value_type") else column.dictionary_encode()
    column_texts: list[str] = []
    for chunk in encoded.chunks:
        words = ["" if word is None else str(word) for word in chunk.dictionary.to_pylist()]
        column_texts += ["" if index is None else words[index] for index in chunk.indices.to_pylist()]
    return column_texts


def joint_names(path: Path) -> dict[str, list[str]]:
    """Return the names of the elements of lists, by `meta/info.json` of a LeRobot dataset; empty for other files."""
    folders = path.resolve().parents
    info = folders[min(META_DEPTH, len(folders)) - 1] / "meta" / "info.json"
    try:
        with open_regular(info, MOST_INFO_BYTES) as raw:
            features = json.load(raw)["features"]
        names_by_feature = {str(name): feature.get("names") for name, feature in features.items()}
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return {}  # not a LeRobot dataset, so that elements are named by number
    # older datasets have the list under a further key: {"motors": [...]}
    joint_lists = {
        name: next(iter(names.values()), None) if isinstance(names, dict) else names
        for name, names in names_by_feature.items()
    }
    return {
        name: names
        for name, names in joint_lists.items()
        if isinstance(names, list) and all(isinstance(joint, str) for joint in names)
    }
