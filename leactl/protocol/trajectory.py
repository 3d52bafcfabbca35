"""Read trajectories from CSV files with a column `time_s`, which increases, and a column whose name ends in its unit.

Other columns are ignored. Values between rows are interpolated linearly; the signal starts at the first row's time.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from leactl.errors import InputError
from leactl.protocol.schema import MAX_DURATION_S, MAX_SAMPLES
from leactl.protocol.setpointkeys import Spelling

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

MAX_BYTES = 1 << 28  # of a file
MAX_VALUE = 1e6  # magnitude of any number of a file, as of any setpoint
MAX_FAULTS = 20  # faults that are reported; a file in the wrong unit has one in every row


def read(path: Path, column: str | None, spelling: Spelling) -> tuple["Array", "Array"]:
    """Return times (n,) from zero [s], and setpoints (n,).

    Parameters
    ----------
    column : name of the setpoint column; None for `spelling.setpoint`.
    spelling : name and unit suffix of the setpoint.

    Raises
    ------
    InputError : the column's name does not end in the unit; the file is absent or too large, lacks a column, has fewer
        than two rows or more than `MAX_SAMPLES`, lasts longer than `MAX_DURATION_S`, or has a number that is not
        finite, too large, or not after the last time.
    """
    from leactl.tables.columns import Columns, CsvForm

    column_name = column or spelling.setpoint
    if not column_name.endswith(f"_{spelling.suffix}"):
        raise InputError(f"column '{column_name}': a name that ends in _{spelling.suffix} was expected")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    names, form = ("time_s", column_name), CsvForm(comment="", missing=())
    table = Columns(
        path, form, names, strict=True, most_bytes=MAX_BYTES, most_rows=MAX_SAMPLES + 1, most_faults=MAX_FAULTS
    )
    if any(table.names.count(name) != 1 for name in names):
        present = ", ".join(table.names)[:200] or "nothing"
        raise InputError(
            f"{path}: line 1: columns 'time_s' and '{column_name}' were expected, each once; found {present}"
        )
    if len(table.lines) > MAX_SAMPLES:
        raise InputError(f"{path}: more than {MAX_SAMPLES} rows")
    if len(table.lines) < 2:
        raise InputError(f"{path}: two rows or more were expected below the header")
    times, values = table.numbers(names, MAX_VALUE).T
    if times[-1] - times[0] > MAX_DURATION_S:
        raise InputError(f"{path}: {times[-1] - times[0]:g} s long; at most {MAX_DURATION_S:g} s was expected")
    return times - times[0], values
