"""Read tables of text, such as CSV, in the format that the mapping states."""

import re
from collections.abc import Iterable
from contextlib import suppress
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.runfile.importing.mapping import as_label
from leactl.runfile.importing.sources.source import ListedColumn, ListedTable, MissingColumn, SourceRequest
from leactl.tables.columns import Columns, CsvForm

Array = npt.NDArray[np.float64]
ENDINGS = (".csv", ".txt", ".tsv")
TAIL_BYTES = 8192  # of a file, whose rows tell whether the last one is cut; an even number, for UTF-16
PADDED_NUMBER = re.compile("0[0-9]+")
SURVEYED_ROWS = 200  # leading rows by which a column is judged to be numeric


def open_source(path: Path, request: SourceRequest) -> "CsvSource":
    """Open a table of text.

    Raises
    ------
    InputError : the file cannot be read, or is not in the format that the mapping states.
    """
    return CsvSource(path, request)


class CsvSource(Columns):
    """Source over a table of text."""

    began = None
    has_text = True
    number_of_word: ClassVar = {"true": 1.0, "false": 0.0}

    def __init__(self, path: Path, request: SourceRequest) -> None:
        form = request.csv
        requested = None if request.columns is None else [column.name for column in request.columns]
        labels = [column.name for column in request.labels]
        super().__init__(
            path,
            form,
            requested,
            labels,
            settings_prefix="csv.",
            most_rows=SURVEYED_ROWS if requested is None else None,
        )
        self.remarks: list[str] = []
        if requested is not None and self.lines and self.lines[-1] == self.last_line:
            lengths = lengths_of_last_cells(path, form, len(self.lines))
            if len(lengths) > 1 and lengths[-1] < min(lengths[:-1]):
                self.remarks.append(f"the last row, line {self.drop_last_row()}, has no end and is cut: left out")
        if not self.lines:
            raise InputError(f"{path}: no row of numbers after line {(form.data_line or form.header_line + 1) - 1}")

    def column(self, name: str | int, records: str | None = None) -> Array | list[str]:
        """Return a column by header or index."""
        return super().column(self._known(name, self._columns))

    def labels(self, name: str | int, records: str | None) -> list[str]:
        """Return a column by header or index, as labels."""
        return [*map(cache(self._label), self._labels[self._known(name, self._labels)])]

    def _label(self, cell: str) -> str:
        """Convert a cell to a label; a number gets its shortest form."""
        with suppress(ValueError):
            return cell if cell.lower() in self.number_of_word else as_label(self.number(cell))
        return cell

    def _known(self, name: str | int, available: Iterable[int]) -> int:
        """Return the index of a column that the import asked for.

        Raises
        ------
        MissingColumn : the table has no such column, or several of that name.
        """
        if isinstance(name, str) and self.names.count(name) > 1:
            raise MissingColumn(f"{self.path}: the header has {name!r} {self.names.count(name)} times; give its index")
        index = self.position(name)
        if index not in available:
            headers_text = ", ".join(self.names) if self.names else "no header"
            hint = "; is csv.delimiter right?" if len(self.names) == 1 else ""
            raise MissingColumn(f"{self.path} has no column {name!r}; it has {headers_text}{hint}")
        return index

    def is_number(self, cell: str) -> bool:
        """Return whether a cell is a number, or marks a missing one."""
        with suppress(ValueError):
            return cell in self._missing or self.number(cell) is not None
        return False

    def field(self, name: str | int) -> float | str:
        """Return the value of a column that never changes; digits behind a zero, such as a serial number, as text."""
        cells = set(self._labels.get(self.position(name), ()))
        if len(cells) == 1 and PADDED_NUMBER.fullmatch(cell := next(iter(cells))):
            return cell
        values = self.column(name)
        distinct_values = set(values) if isinstance(values, list) else set(values[np.isfinite(values)].tolist())
        if len(distinct_values) != 1:
            raise MissingColumn(
                f"{self.path}: column {name!r} holds {len(distinct_values)} values where one was expected"
            )
        value = distinct_values.pop()
        return value if isinstance(value, str) else float(value)

    def tables(self) -> list[ListedTable]:
        """Return one table of the columns of numbers, named by header, or by index without a unique header.

        Its stamps are the first column of dates with a time of day, if there is one.
        """
        listed = []
        left_out: list[tuple[str | int, str]] = []
        time: ListedColumn | None = None
        for index, cells in sorted(self._columns.items()):
            name = self.names[index] if index < len(self.names) else ""
            texts = [str(cell) for cell in cells]
            column = name if self.names.count(name) == 1 and name else index
            if all(map(self.is_number, texts)) and not self._missing.issuperset(texts):
                why_unnamed = (
                    f"its header stands over {self.names.count(name)} columns" if self.names.count(name) > 1 else ""
                )
                listed.append(ListedColumn(column, why_unnamed=why_unnamed))
            elif time is None and all(map(is_moment, texts)):
                time = ListedColumn(column, "iso8601", "ISO 8601, as its cells are")
            elif 2 * sum(map(self.is_number, texts)) > len(texts):
                row, cell = next((row, text) for row, text in enumerate(texts) if not self.is_number(text))
                left_out.append(
                    (
                        column,
                        f"{cell!r} in line {self.lines[row]} is no number; csv.missing has what marks a missed sample",
                    )
                )
        return [ListedTable(None, tuple(listed), time=time, left_out=tuple(left_out))]


def lengths_of_last_cells(path: Path, form: CsvForm, rows: int) -> list[int]:
    """Return the lengths of the last cells of the last rows of a file; none if the file ends in a newline.

    rows : number of rows that the file has.
    """
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - TAIL_BYTES, 0))
        text = file.read().decode(form.encoding, "ignore")
    if text.endswith(("\n", "\r")):
        return []
    whole_lines = text.splitlines()[1:] if path.stat().st_size > TAIL_BYTES else text.splitlines()
    return [len(line.rpartition(form.delimiter)[2].strip()) for line in whole_lines[-rows:]]


def is_moment(text: str) -> bool:
    """Return whether a cell is a date with a time of day by ISO 8601."""
    with suppress(ValueError):
        return ":" in text and datetime.fromisoformat(text) is not None
    return False
