"""Read columns of a text table in a stated format, row by row; only the requested columns take memory."""

import sys
from array import array
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from leactl.errors import InputError
from leactl.tables.number_format import PLAIN_CHARACTERS, Character, NumberFormat, TableFormat
from leactl.tables.text_table import MOST_FAULTS, cell_location, open_text, rows_of, strip_cells, width_fault

Array = npt.NDArray[np.float64]
Line = Annotated[int, Field(strict=True, ge=0)]


class CsvForm(TableFormat):
    """Dialect of a CSV file."""

    delimiter: Character = ","
    decimal: Literal[".", ","] = "."
    thousands: Literal["", ",", ".", " ", "'"] = ""
    comment: str = "#"
    encoding: str = "utf-8-sig"
    header_line: Line = 1  # counted from 1; 0 for no header: columns have indices alone
    data_line: Line | None = None  # first line of numbers, counted from 1; None for the line after the header
    missing: tuple[str, ...] = ("", "nan", "NaN", "NA", "N/A", "#N/A", "null")  # cells of missed samples

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        """Raise ValueError if the numbers do not begin below the header."""
        if self.data_line is not None and self.data_line <= self.header_line:
            raise ValueError(f"data_line {self.data_line} is not after header_line {self.header_line}")
        return self


class Columns:
    """Read the requested columns of one table when constructed: numbers as arrays, labels as text.

    Parameters
    ----------
    form : format of the table.
    requested : names, or indices from 0, of columns of numbers; None reads every column as text. Names that the header
        lacks are left out.
    labels : names, or indices from 0, of columns that are read as text.
    settings_prefix : prefix of the names of settings in messages, such as `csv.`; empty if the user cannot set them.
    every_row : whether rows without any value are read.
    strict : whether a cell that begins with a quote has to end with one.
    most_bytes : largest size of the file; None for no limit.
    most_rows : number of rows after which reading ends; None for no limit.
    most_faults : number of faults after which reading ends.

    Raises
    ------
    InputError : the file cannot be read, is not in the stated format, has rows of another width, a quoted cell that
        does not end in its line, or a blank line between rows of one column; at most `most_faults` lines.
    """

    number_of_word: ClassVar[Mapping[str, float]] = {}  # such as "true": 1.0; keys in lower case
    has_text: ClassVar[bool] = False  # whether a column whose first cell is not a number is read as text

    def __init__(
        self,
        path: Path,
        form: CsvForm,
        requested: Sequence[str | int] | None,
        labels: Sequence[str | int] = (),
        *,
        settings_prefix: str = "",
        every_row: bool = True,
        strict: bool = False,
        most_bytes: int | None = None,
        most_rows: int | None = None,
        most_faults: int = MOST_FAULTS,
    ) -> None:
        self.path = path
        self.names: list[str] = []  # cells of the header
        self.lines = array("q")  # line number of each row
        self._columns: dict[int, list[str] | array[float]] = {}  # by index
        self._labels: dict[int, list[str]] = {}  # by index
        self._faults: list[str] = []
        self._most_faults = most_faults
        self._missing = frozenset(form.missing)
        self._decimal = form.decimal
        self._format = NumberFormat(form.decimal, form.thousands)
        self._advice = f"; if it marks a missed sample, add it to {settings_prefix}missing" if settings_prefix else ""
        first_line, comment, width = form.data_line or form.header_line + 1, form.comment, 0
        self.last_line = 0  # number of the last line that was read
        blank_line = 0  # number of a blank line after the last row
        with open_text(
            path, form.encoding, most_bytes, f"; {settings_prefix}encoding decides" if settings_prefix else ""
        ) as file:
            for line, cells in rows_of(path, file, form.delimiter, strict):
                if line > self.last_line + 1 and line >= first_line:
                    raise InputError(
                        f"{path}: line {self.last_line + 1}: a quote opens a cell that does not end in its line"
                    )
                self.last_line = line
                if line == form.header_line:
                    self.names = [cell.strip() for cell in cells]
                    if form.delimiter == " " and self.names[:1] == [comment]:
                        self.names = self.names[1:]  # numpy.savetxt writes `# t q`
                if line < first_line or not (cells if every_row else any(cells)):
                    blank_line = blank_line or line
                    continue
                if comment and cells[0].startswith(comment) and cells[0].strip() not in self._missing:
                    continue
                if not width:
                    width = self._choose_columns(requested, labels, line, cells)
                if width == 1 and self.lines and blank_line > self.lines[-1]:
                    self._faults.append(f"{path}: line {blank_line}: is blank; write a missed sample as nan")
                blank_line = 0
                if len(cells) != width and (fault := width_fault(path, line, cells, width)):
                    self._faults.append(fault)
                else:
                    self._append_row(line, cells)
                if len(self._faults) >= most_faults or len(self.lines) == most_rows:
                    break
        if self._faults:
            raise InputError(self._faults[:most_faults])  # one row may have several faults

    def _choose_columns(
        self, requested: Sequence[str | int] | None, labels: Sequence[str | int], line: int, cells: list[str]
    ) -> int:
        """Choose the columns to read, and return the number of cells of a row.

        Where a column is requested by name, a row has as many cells as the header, else as many as the first row.
        """
        width, name_count = len(cells), len(strip_cells(self.names))
        if name_count and any(isinstance(name, str) for name in (*(requested or ()), *labels)):
            expected = min(max(width, name_count), len(self.names))
            if fault := width_fault(self.path, line, cells, expected):
                raise InputError(fault)
            width = min(width, expected)
        if requested is None:
            self._columns = {index: [] for index in range(width)}
        else:
            self._columns = {index: array("d") for name in requested if (index := self.position(name)) in range(width)}
        self._labels = {index: [] for name in labels if (index := self.position(name)) in range(width)}
        return width

    def _append_row(self, line: int, cells: list[str]) -> None:
        """Append the cells of a row to the columns.

        A cell that is no number becomes NaN and a fault. If it is the first cell of its column and `has_text` is set,
        the column becomes text instead.
        """
        self.lines.append(line)
        for index, column in self._columns.items():
            cell = cells[index].strip()
            if isinstance(column, list):
                column.append(cell)
                continue
            try:
                column.append(np.nan if cell in self._missing else self.number(cell))
            except ValueError:
                if column or not self.has_text:
                    column.append(np.nan)
                    location = self.location(self.names[index] if index < len(self.names) else index, -1)
                    self._faults.append(f"{location}: {cell!r} is not a number{self._advice}")
                else:
                    self._columns[index] = [cell]  # a column of text: run metadata, or calendar stamps
        for index, texts in self._labels.items():
            texts.append(sys.intern(cells[index].strip()))  # millions of rows share a few texts

    def drop_last_row(self) -> int:
        """Drop the last row, and return the number of its line."""
        for column in (*self._columns.values(), *self._labels.values()):
            column.pop()
        return self.lines.pop()

    def number(self, cell: str) -> float:
        """Return the number in a cell, read in the stated format.

        Raises
        ------
        ValueError : the cell is not a number.
        """
        value = None
        # float() accepts underscores, and a point where the decimal mark is a comma
        is_python_only = "_" in cell or (self._decimal == "," and "." in cell)
        with suppress(ValueError):
            if self._format.thousands:
                value = self._format.value(cell.translate(PLAIN_CHARACTERS))
            elif not is_python_only:
                return float(cell if self._decimal == "." else cell.replace(self._decimal, "."))
        value = self.number_of_word.get(cell.lower()) if value is None else value
        if value is None:
            raise ValueError(cell)
        return value

    def position(self, name: str | int) -> int:
        """Return the index of the first column of a name, -1 if there is none; an index is returned as it is."""
        return name if isinstance(name, int) else self.names.index(name) if name in self.names else -1

    def location(self, name: str | int, row: int) -> str:
        """Return file, line and column of a cell, for messages."""
        return cell_location(self.path, self.lines[row], name)

    def column(self, name: str | int) -> Array | list[str]:
        """Return a requested column: text as a list, numbers as an array.

        Raises
        ------
        KeyError : the column was not requested, or the table has no rows.
        """
        values = self._columns[self.position(name)]
        return values if isinstance(values, list) else np.frombuffer(values, np.float64)

    def numbers(self, names: Sequence[str], largest: float) -> Array:
        """Return columns of numbers as an array (rows, columns); the first column, the time, increases strictly.

        Raises
        ------
        InputError : a number is NaN or larger in magnitude than `largest`, or the first column does not increase.
        """
        table: Array = np.stack([np.asarray(self.column(name), np.float64) for name in names], axis=1)
        expected = f"a number of at most {largest:g} in magnitude was expected"
        faults = [
            f"{self.location(names[column], row)}: {table[row, column]:g}: {expected}"
            for row, column in np.argwhere(~(np.abs(table) <= largest))[: self._most_faults].tolist()
        ] or [
            f"{self.location(names[0], row)}: {table[row, 0]:g} is not after {table[row - 1, 0]:g}"
            for row in (np.flatnonzero(np.diff(table[:, 0]) <= 0.0)[: self._most_faults] + 1).tolist()
        ]
        if faults:
            raise InputError(faults)
        return table
