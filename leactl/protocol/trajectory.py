"""Trajectories from CSV files: a header with `time_s` and a column whose name ends in its unit; times increase.

Other columns are ignored. Values between rows are interpolated linearly; the signal starts at the first row's time.
"""

import csv
import math
from array import array
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from leactl.errors import InputError
from leactl.protocol.schema import MAX_DURATION_S, MAX_SAMPLES
from leactl.protocol.setpointkeys import Spelling

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Doubles = array[float]

MAX_BYTES = 1 << 28
MAX_VALUE = 1e6
MAX_FAULTS = 20  # faults reported: a file in the wrong unit has one in every row


def read(path: Path, column: str | None, spelling: Spelling) -> tuple["Array", "Array"]:
    """Times (n,) from zero [s], and setpoints (n,).

    Raises
    ------
    InputError : the file is absent or too large, lacks a column, or has rows without finite, increasing numbers.
    """
    import numpy as np

    wanted = column or spelling.setpoint
    if not wanted.endswith(f"_{spelling.suffix}"):
        raise InputError(f"column '{wanted}': a name that ends in _{spelling.suffix} was expected")
    try:
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(f"{path}: {size} bytes; a file of at most {MAX_BYTES} bytes was expected")
        with path.open(encoding="utf-8-sig", newline="") as stream:
            times, values = _rows(stream, wanted)
    except (OSError, ValueError) as error:  # a path may hold characters that no file name can
        raise InputError(f"{path}: {error}") from None
    moments = np.array(times)
    return moments - moments[0], np.array(values)


def _rows(stream: TextIO, wanted: str) -> "tuple[Doubles, Doubles]":
    name, reader = stream.name, csv.reader(stream, strict=True)
    faults: list[str] = []
    times, values = array("d"), array("d")
    try:
        header = [cell.strip() for cell in next(reader, [])]
        if header.count("time_s") != 1 or header.count(wanted) != 1:
            columns_present = ", ".join(header)[:200] or "nothing"
            raise InputError(
                f"{name}:1: columns 'time_s' and '{wanted}' were expected, each once; found {columns_present}"
            )
        columns = header.index("time_s"), header.index(wanted)
        for row in reader:
            if not row:
                continue
            fault = _take(row, columns, (times, values))
            if fault:
                faults.append(f"{name}:{reader.line_num}: {fault}")
            if len(faults) == MAX_FAULTS or len(times) > MAX_SAMPLES:
                break
    except csv.Error as error:
        faults.append(f"{name}:{reader.line_num}: {error}")
    if len(times) > MAX_SAMPLES:
        faults.append(f"{name}: more than {MAX_SAMPLES} rows")
    elif not faults and len(times) < 2:
        faults.append(f"{name}: two rows or more were expected below the header")
    elif not faults and times[-1] - times[0] > MAX_DURATION_S:
        faults.append(f"{name}: {times[-1] - times[0]:g} s long; at most {MAX_DURATION_S:g} s was expected")
    if faults:
        raise InputError(faults)
    return times, values


def _take(row: list[str], columns: tuple[int, int], into: "tuple[Doubles, Doubles]") -> str:
    """Add a row; returns the reason if it is invalid, else ""."""
    if len(row) <= max(columns):
        return f"{max(columns) + 1} columns were expected; found {len(row)}"
    cells = [row[column].strip() for column in columns]
    numbers = []
    for cell in cells:
        try:
            numbers.append(float(cell))
        except ValueError:
            numbers.append(math.nan)
        if not abs(numbers[-1]) <= MAX_VALUE:
            return f"{cell[:40]!r}: a number of at most {MAX_VALUE:g} in magnitude was expected"
    times, values = into
    if times and not numbers[0] > times[-1]:
        return f"time_s {numbers[0]:g} is not after {times[-1]:g}"
    times.append(numbers[0])
    values.append(numbers[1])
    return ""
