"""Export a run to CSV, MATLAB or Parquet for programs that do not read HDF5.

CSV and Parquet get one file per stream, MATLAB one file for the run. No file is overwritten, and an interrupted export
leaves no incomplete file.
"""

import csv
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from leactl.errors import InputError
from leactl.runfile.importing.sources.formats.parquet import modules
from leactl.runfile.publish import new_file, refuse_existing
from leactl.runfile.read.reader import Run

Format = Literal["csv", "mat", "parquet"]
FORMULA_STARTS = ("=", "+", "-", "@")  # first characters of a formula in a spreadsheet (OWASP, "CSV injection")
CONTROL_CHARACTERS = re.compile("[\x00-\x1f\x7f]")  # for some programs, a single carriage return begins a new row
LONGEST_FIELD_NAME = 63  # characters of a name in MATLAB


def export(run_path: Path, fmt: str, out: Path) -> list[Path]:
    """Write a run into the directory `out` as `<run>.<stream>.csv`, `<run>.<stream>.parquet` or `<run>.mat`.

    Returns
    -------
    The files written.

    Raises
    ------
    InputError : unknown format, a run that cannot be read, a file that exists, or pyarrow missing for Parquet.
    """
    if fmt not in get_args(Format):
        raise InputError(f"format {fmt!r} is none of {', '.join(get_args(Format))}")
    with Run.open(run_path) as run:
        writers = WRITERS[fmt](run)
        targets = {out / f"{run_path.stem}{suffix}": write for suffix, write in writers.items()}
        for target in targets:
            refuse_existing(target)
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{out}: cannot be made: {error.strerror or error}; choose another --out") from None
        with ExitStack() as published:  # all files are written before the first takes its name
            for target, write in targets.items():
                write(published.enter_context(new_file(target)))
    return list(targets)


Writer = Callable[[Path], None]  # writes a file at a path that does not exist yet


def csv_writers(run: Run) -> dict[str, Writer]:
    """Return a writer of a CSV file for each stream, by the file name's suffix."""

    def write(stream: str, target: Path) -> None:
        with target.open("x", encoding="utf-8", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(["time [s]", *(heading(f"{spec.name} [{spec.units}]") for spec in run.streams[stream])])
            for block in run.blocks(stream, rows=1 << 14):
                table.writerows(zip(*(numerals(column) for column in block.values()), strict=True))

    return {f".{stream}.csv": partial(write, stream) for stream in run.streams}


def heading(text: str) -> str:
    """Return a heading that no spreadsheet reads as a formula: a leading `=`, `+`, `-` or `@` gets an apostrophe."""
    printable_text = CONTROL_CHARACTERS.sub("\N{REPLACEMENT CHARACTER}", text)
    return f"'{printable_text}" if printable_text.startswith(FORMULA_STARTS) else printable_text


def numerals(column: np.ndarray[Any, Any]) -> Iterator[str]:
    """Yield the shortest decimal texts that read back as the same values; float32 needs at most nine digits."""
    return (f"{value:.9g}" if column.itemsize < 8 else repr(value) for value in column.tolist())


def parquet_writers(run: Run) -> dict[str, Writer]:
    """Return a writer of a Parquet file for each stream, with units and the run's attributes as metadata."""
    arrow, parquet = modules()

    def write(stream: str, target: Path) -> None:
        fields = [arrow.field("time", arrow.float64(), metadata={"units": "s"})]
        for spec in run.streams[stream]:
            stated_fields = {
                key: value for key, value in spec._asdict().items() if value and key not in ("name", "dtype")
            }
            metadata = {key: str(value) for key, value in stated_fields.items()}
            fields.append(arrow.field(spec.name, arrow.from_numpy_dtype(spec.dtype), metadata=metadata))
        schema = arrow.schema(fields, metadata={key: str(value) for key, value in run.attributes.items()})
        with parquet.ParquetWriter(target, schema) as table:
            for block in run.blocks(stream):
                native_columns = [column.astype(column.dtype.newbyteorder("=")) for column in block.values()]
                table.write_table(arrow.table([*map(arrow.array, native_columns)], schema=schema))

    return {f".{stream}.parquet": partial(write, stream) for stream in run.streams}


def mat_writers(run: Run) -> dict[str, Writer]:
    """Return the writer of a MATLAB file: a struct for each group, `streams.<stream>.<channel>` for channels."""
    from scipy.io import savemat

    def write(target: Path) -> None:
        content = {
            "run": matlab_fields({**run.attributes}),
            "setup": matlab_fields({**run.setup}),
            "parameters": matlab_fields(run.parameters),
            "instruments": matlab_fields({name: matlab_fields({**facts}) for name, facts in run.instruments.items()}),
            "streams": matlab_fields({stream: mat_stream(run, stream) for stream in run.streams}),
            "steps": [matlab_fields({**vars(step), "parameters": str(step.parameters)}) for step in run.steps],
            "events": [matlab_fields(vars(event)) for event in run.events],
        }
        with target.open("xb") as file:
            savemat(file, content, long_field_names=True, do_compression=True, oned_as="column")

    return {".mat": write}


def mat_stream(run: Run, stream: str) -> dict[str, Any]:
    """Return one stream as a struct of channels, each a struct of values, quantity, role, units and names."""
    columns: dict[str, Any] = {"time": run.time(stream)}
    values_by_name = {name: np.concatenate(parts) for name, parts in all_rows(run, stream).items()}
    for spec in run.streams[stream]:
        stated_fields = {key: value for key, value in spec._asdict().items() if value and key != "dtype"}
        columns[spec.name] = matlab_fields({"values": values_by_name[spec.name], **stated_fields})
    return matlab_fields(columns)


def all_rows(run: Run, stream: str) -> dict[str, list[np.ndarray[Any, Any]]]:
    """Return the blocks of all rows of a stream, by channel name."""
    columns: dict[str, list[np.ndarray[Any, Any]]] = {
        spec.name: [np.empty(0, spec.dtype)] for spec in run.streams[stream]
    }
    for block in run.blocks(stream):
        for name in columns:
            columns[name].append(block[name])
    return columns


def matlab_fields(fields: dict[str, Any]) -> dict[str, Any]:
    """Rename fields to distinct names that MATLAB accepts: letters, digits and underscores, a letter first."""
    renamed_fields: dict[str, Any] = {}
    for name, value in fields.items():
        valid_name = re.sub(r"\W", "_", name, flags=re.ASCII)
        valid_name = (valid_name if valid_name[:1].isalpha() else f"x{valid_name}")[:LONGEST_FIELD_NAME]
        field, number = valid_name, 1
        while field in renamed_fields:
            number += 1
            field = f"{valid_name[: LONGEST_FIELD_NAME - 4]}_{number}"
        renamed_fields[field] = value
    return renamed_fields


WRITERS: dict[str, Callable[[Run], dict[str, Writer]]] = {
    "csv": csv_writers,
    "mat": mat_writers,
    "parquet": parquet_writers,
}
