"""Columns of a text table whose format is stated, read row by row: only the columns that are asked for take memory."""

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
from leactl.tables.number_format import SPACES, Character, NumberFormat, TableFormat
from leactl.tables.text_table import MOST_FAULTS, cell_place, open_text, rows_of, strip_cells, width_fault

Array = npt.NDArray[np.float64]
Line = Annotated[int, Field(strict=True, ge=0)]


class CsvForm(TableFormat):
    """Dialect of a CSV file."""

    delimiter: Character = ","
    decimal: Literal[".", ","] = "."
    thousands: Literal["", ",", ".", " ", "'"] = ""
    comment: str = "#"
    encoding: str = "utf-8-sig"
    header_line: Line = 1  # counted from 1; 0: none, columns go by index
    data_line: Line | None = None  # where numbers begin; the line after the header by default
    missing: tuple[str, ...] = ("", "nan", "NaN", "NA", "N/A", "#N/A", "null")  # cells of missed samples

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.data_line is not None and self.data_line <= self.header_line:
            raise ValueError(f"data_line {self.data_line} is not after header_line {self.header_line}")
        return self


class Columns:
    """Columns of numbers of one table, and columns of labels.

    Parameters
    ----------
    wanted : names, or indices from 0; None keeps every column as text. Names that the header lacks are left out.
    labels : columns that are kept as text.
    options : prefix of the options in messages; empty if nobody can set them.
    every_row : whether rows without a value count.
    strict : whether a quote has to end with its cell.
    most_rows : rows after which the reading ends.

    Raises
    ------
    InputError : unreadable, not in the stated format, or rows of another width; `most_faults` lines at most.
    """

    words: ClassVar[Mapping[str, float]] = {}  # in lower case, that are numbers
    has_text: ClassVar[bool] = False  # whether a column is text if its first cell is neither a number nor a missing one

    def __init__(
        self,
        path: Path,
        form: CsvForm,
        wanted: Sequence[str | int] | None,
        labels: Sequence[str | int] = (),
        *,
        options: str = "",
        every_row: bool = True,
        strict: bool = False,
        most_bytes: int | None = None,
        most_rows: int | None = None,
        most_faults: int = MOST_FAULTS,
    ) -> None:
        self.path, self.names, self.lines = path, list[str](), array("q")
        self._kept: dict[int, list[str] | array[float]] = {}
        self._labels: dict[int, list[str]] = {}
        self._faults, self._most_faults, self._missing = list[str](), most_faults, frozenset(form.missing)
        self._decimal, self._format = form.decimal, NumberFormat(form.decimal, form.thousands)
        self._advice = f"; if it marks a missed sample, add it to {options}missing" if options else ""
        first, comment, width = form.data_line or form.header_line + 1, form.comment, 0
        with open_text(path, form.encoding, most_bytes, f"; {options}encoding decides" if options else "") as file:
            for line, cells in rows_of(path, file, form.delimiter, strict):
                if line == form.header_line:
                    self.names = [cell.strip() for cell in cells]
                    if form.delimiter == " " and self.names[:1] == [comment]:
                        self.names = self.names[1:]  # `# t q` of numpy.savetxt
                if line < first or not (cells if every_row else any(cells)):
                    continue
                if comment and cells[0].startswith(comment) and cells[0].strip() not in self._missing:
                    continue
                if not width:
                    width = self._choose(wanted, labels, line, cells)
                if len(cells) != width and (fault := width_fault(path, line, cells, width)):
                    self._faults.append(fault)
                else:
                    self._keep(line, cells)
                if len(self._faults) >= most_faults or len(self.lines) == most_rows:
                    break
        if self._faults:
            raise InputError(self._faults[:most_faults])  # a row may have several

    def _choose(
        self, wanted: Sequence[str | int] | None, labels: Sequence[str | int], line: int, cells: list[str]
    ) -> int:
        """Choose the columns to keep and return how many cells a row has: as the header, where columns go by name."""
        width, named = len(cells), len(strip_cells(self.names))
        if named and any(isinstance(name, str) for name in (*(wanted or ()), *labels)):
            expected = min(max(width, named), len(self.names))
            if fault := width_fault(self.path, line, cells, expected):
                raise InputError(fault)
            width = min(width, expected)
        if wanted is None:
            self._kept = {at: [] for at in range(width)}
        else:
            self._kept = {at: array("d") for name in wanted if (at := self.position(name)) in range(width)}
        self._labels = {at: [] for name in labels if (at := self.position(name)) in range(width)}
        return width

    def _keep(self, line: int, cells: list[str]) -> None:
        self.lines.append(line)
        for at, column in self._kept.items():
            cell = cells[at].strip()
            if isinstance(column, list):
                column.append(cell)
                continue
            try:
                column.append(np.nan if cell in self._missing else self.number(cell))
            except ValueError:
                if column or not self.has_text:
                    column.append(np.nan)
                    place = self.place(self.names[at] if at < len(self.names) else at, -1)
                    self._faults.append(f"{place}: {cell!r} is not a number{self._advice}")
                else:
                    self._kept[at] = [cell]  # a column of text: run metadata, or stamps by the calendar
        for at, texts in self._labels.items():
            texts.append(sys.intern(cells[at].strip()))  # a few texts stand in millions of rows

    def number(self, cell: str) -> float:
        """The number that a cell stands for.

        Raises
        ------
        ValueError : it is no number.
        """
        value = None
        # float() takes underscores, and a point where a comma was expected
        strange = "_" in cell or (self._decimal == "," and "." in cell)
        with suppress(ValueError):
            if self._format.thousands:
                value = self._format.value(cell.translate(SPACES))
            elif not strange:
                return float(cell if self._decimal == "." else cell.replace(self._decimal, "."))
        value = self.words.get(cell.lower()) if value is None else value
        if value is None:
            raise ValueError(cell)
        return value

    def position(self, name: str | int) -> int:
        """Index of the first column of a name; -1 if there is none."""
        return name if isinstance(name, int) else self.names.index(name) if name in self.names else -1

    def place(self, name: str | int, row: int) -> str:
        """File, line and column of a cell for messages."""
        return cell_place(self.path, self.lines[row], name)

    def column(self, name: str | int) -> Array | list[str]:
        """A column that was asked for and that the table has."""
        values = self._kept[self.position(name)]
        return values if isinstance(values, list) else np.frombuffer(values, np.float64)

    def numbers(self, names: Sequence[str], largest: float) -> Array:
        """Columns (rows, columns) of which each cell is a number and the first increases from row to row.

        Raises
        ------
        InputError : a number is NaN or larger in magnitude than `largest`, or one of the first column is not after the
            one before.
        """
        table: Array = np.stack([np.asarray(self.column(name), np.float64) for name in names], axis=1)
        expected = f"a number of at most {largest:g} in magnitude was expected"
        faults = [
            f"{self.place(names[at], row)}: {table[row, at]:g}: {expected}"
            for row, at in np.argwhere(~(np.abs(table) <= largest))[: self._most_faults].tolist()
        ] or [
            f"{self.place(names[0], row)}: {table[row, 0]:g} is not after {table[row - 1, 0]:g}"
            for row in (np.flatnonzero(np.diff(table[:, 0]) <= 0.0)[: self._most_faults] + 1).tolist()
        ]
        if faults:
            raise InputError(faults)
        return table
