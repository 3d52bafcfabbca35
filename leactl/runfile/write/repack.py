"""Write the final form of a run: compressed, with strings of variable length and a checksum on every dataset.

The writer calls `repack` at an orderly close, `recover` (verify/integrity.py) after a kill; both pass an open file and
the number of valid rows of each stream.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from leactl.runfile import layout, seal
from leactl.runfile.hdf5.space import reserve, trim

Row = Mapping[str, Any]

COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 4, "shuffle": True}
CHUNK_ROWS = 1 << 14  # 128 KiB of float64


def repack(
    source: Any,
    target: Path,
    *,
    status: str,
    reason: str,
    row_counts: Mapping[str, int],
    tables: Mapping[str, Sequence[Row]],
) -> None:
    """Copy a run into a new file.

    Parameters
    ----------
    source : the open live file.
    target : a path that does not exist.
    row_counts : number of valid rows of each stream; a stream that is not named is left out.
    tables : the rows of `/steps` and `/events`.
    """
    with h5py.File(target, "x", libver=layout.HDF5_FORMAT) as final:
        reserve(final, 0)  # the space that `reserve` always keeps in addition
        for name in source.attrs:
            if name not in seal.DIGEST_ATTRIBUTES:
                final.attrs[name] = source.attrs[name]
        final.attrs["status"] = status
        final.attrs["status_reason"] = one_line(reason)
        copy_setup_and_sources(source, final)
        layout.copy_description(source, final)
        streams = final.create_group("streams")
        for name, count in row_counts.items():
            copy_stream(source["streams"][name], streams.create_group(name, track_order=True), count)
        reserve(
            final,
            sum(text_bytes(as_text(cell)) for table in tables.values() for row in table for cell in row.values()),
        )
        for name, columns in layout.TABLES.items():
            write_table(final.create_group(name), columns, tables.get(name, ()))
        put_seal(final)
    trim(target)


def put_seal(file: Any) -> None:
    """Write the seal of a complete file."""
    rows = seal.table_of(file)
    reserve(file, sum(text_bytes(cell) for row in rows for cell in row.values()))
    write_table(file.create_group(seal.SEAL), seal.COLUMNS, rows)
    file.attrs[seal.SEAL] = seal.digest_of_table(rows)


def copy_setup_and_sources(source: Any, final: Any) -> None:
    """Copy `/setup` and the YAML texts of protocol, bench and model."""
    setup = final.create_group("setup")
    if "setup" in source:
        for name in source["setup"].attrs:
            setup.attrs[name] = source["setup"].attrs[name]
    for name in layout.SOURCES:
        if f"{name}/source" in source:
            text = layout.to_python(source[f"{name}/source"][()])
            reserve(final, text_bytes(text))
            write_source(final, name, text)


def write_source(file: Any, name: str, text: str) -> None:
    """Store one YAML text with its checksum, which equals `sha256sum` of its file."""
    dataset = file.create_dataset(f"{name}/source", data=text, dtype=layout.TEXT)
    dataset.attrs["sha256"] = layout.digest(dataset)


def copy_stream(source: Any, target: Any, count: int) -> None:
    """Copy the first `count` rows of every column of a stream, with a checksum for each column."""
    time = copy_column(source["time"], target, count)
    time.make_scale("time")
    for name in source:
        if name != "time":
            copy_column(source[name], target, count).dims[0].attach_scale(time)


def copy_column(source: Any, target: Any, count: int) -> Any:
    """Copy the first `count` rows of a column block by block, with its attributes and a new checksum."""
    name = source.name.rsplit("/", 1)[-1]
    dtype = source.dtype.newbyteorder("<")
    chunks = (max(1, min(CHUNK_ROWS, count)),)
    dataset = target.create_dataset(name, (count,), dtype=dtype, chunks=chunks, maxshape=(None,), **COMPRESSION)
    sha = hashlib.sha256()
    for start in range(0, count, layout.BLOCK_ROWS):
        block = layout.little_endian(source[start : min(start + layout.BLOCK_ROWS, count)])
        reserve(dataset.file, block.nbytes)
        dataset[start : start + len(block)] = block
        dataset.flush()
        sha.update(block.tobytes())
    for key, value in layout.attributes(source).items():
        dataset.attrs[key] = value
    dataset.attrs["sha256"] = sha.hexdigest()
    return dataset


def write_table(group: Any, columns: Mapping[str, int | None], rows: Sequence[Row]) -> None:
    """Store rows as one dataset for each column.

    Parameters
    ----------
    columns : by name, the width of a text in the live file, or None for numbers; here texts have variable length.
    """
    for column, width in columns.items():
        values = [row[column] for row in rows]
        if width is None:
            dataset = group.create_dataset(column, data=np.array(values, "<f8"))
        else:
            dataset = group.create_dataset(column, (len(values),), dtype=layout.TEXT)
            if values:
                dataset[:] = [layout.storable(as_text(value)) for value in values]
        dataset.attrs["sha256"] = layout.digest(dataset)


def as_text(value: Any) -> str:
    """Return a cell as text: a text unchanged, any other value as JSON."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)


def text_bytes(text: str) -> int:
    """Return an upper bound of the bytes of a string of variable length: four per character, and 64 for HDF5."""
    return 4 * len(text) + 64


def one_line(text: str) -> str:
    """Return the text on one line, each run of white space as one space."""
    return layout.storable(" ".join(text.split()))
