"""Tables of text, such as CSV; only the columns that are asked for are kept in memory."""

import csv
import sys
from array import array
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.runfile.importing.mapping import as_label
from leactl.runfile.importing.sources.source import (
    ListedColumn,
    ListedTable,
    MissingColumn,
    SourceRequest,
    WantedColumn,
)

Array = npt.NDArray[np.float64]
ENDINGS = (".csv", ".txt", ".tsv")
MOST_FAULTS = 5
SURVEYED = 200  # leading rows by which a column is judged to be numeric


def open_source(path: Path, request: SourceRequest) -> "CsvSource":
    """Open a table of text.

    Raises
    ------
    InputError : unreadable, or not in the dialect that the mapping states.
    """
    return CsvSource(path, request)


class CsvSource:
    """Source over a table of text."""

    began = None

    def __init__(self, path: Path, request: SourceRequest) -> None:
        self.path, self._form = path, request.csv
        form = request.csv
        self._names: list[str] = []
        self._lines = array("q")
        self._columns: dict[int, list[str] | array[float]] = {}
        self._labels: dict[int, list[str]] = {}
        try:
            with path.open(encoding=form.encoding, newline="") as file:
                self._read(file, request)
        except UnicodeDecodeError as error:
            raise InputError(f"{path}: not {form.encoding} at byte {error.start}; give csv.encoding") from None
        except LookupError:
            raise InputError(f"{path}: csv.encoding {form.encoding!r} is not known") from None
        except csv.Error as error:
            raise InputError(f"{path}: {error}") from None

    def _read(self, file: Any, request: SourceRequest) -> None:
        form, missing = self._form, set(self._form.missing)
        first = form.data_line or form.header_line + 1
        table = csv.reader(file, delimiter=form.delimiter, skipinitialspace=True)
        width = 0
        faults: list[str] = []
        for cells in table:
            line = table.line_num
            if line == form.header_line:
                self._names = [cell.strip() for cell in cells]
            if line < first or not cells or (form.comment and cells[0].startswith(form.comment)):
                continue
            if not width:
                width = len(cells)
                if request.columns is None:
                    self._columns = {at: [] for at in range(width)}
                else:
                    self._columns = {at: array("d") for at in self._found(request.columns, width)}
                self._labels = {at: [] for at in self._found(request.labels, width)}
            if len(cells) != width:
                faults.append(f"{self.path}: line {line}: {len(cells)} cells where {width} were expected")
            else:
                self._lines.append(line)
                for at in self._columns:
                    self._put(at, cells[at].strip(), line, missing)
                for at, texts in self._labels.items():
                    texts.append(sys.intern(cells[at].strip()))  # a few texts stand in millions of rows
            if len(faults) == MOST_FAULTS or (request.columns is None and len(self._lines) == SURVEYED):
                break
        if faults:
            raise InputError(faults)
        if not len(self._lines):
            raise InputError(f"{self.path}: no row of numbers after line {first - 1}")

    def _put(self, at: int, cell: str, line: int, missing: set[str]) -> None:
        column = self._columns[at]
        if isinstance(column, list):
            column.append(cell)
            return
        if cell in missing:
            column.append(np.nan)
            return
        try:
            column.append(float(cell.replace(self._form.decimal, ".")))
        except ValueError:
            lowered = cell.lower()
            if lowered in ("true", "false"):
                column.append(float(lowered == "true"))
            elif len(column) == 0:
                self._columns[at] = [cell]  # a column of text: run metadata, or stamps by the calendar
            else:
                raise InputError(
                    f"{self.path}: line {line}, column {self._called(at)}: {cell!r} is not a number"
                    f"; if it marks a missed sample, add it to csv.missing"
                ) from None

    def _called(self, at: int) -> str:
        return repr(self._names[at]) if at < len(self._names) else str(at)

    def _found(self, wanted: Sequence[WantedColumn], width: int) -> list[int]:
        indices = {self._at(each.name, width) for each in wanted}
        return sorted(at for at in indices if at is not None)

    def _at(self, wanted: str | int, width: int) -> int | None:
        if isinstance(wanted, int):
            return wanted if wanted < width else None
        return self._names.index(wanted) if wanted in self._names[:width] else None

    def column(self, name: str | int, records: str | None) -> Array | list[str]:
        """A column by header or index."""
        values = self._columns[self._known(name, self._columns)]
        return values if isinstance(values, list) else np.frombuffer(values, np.float64)

    def labels(self, name: str | int, records: str | None) -> list[str]:
        """A column by header or index, as labels."""
        cells = self._labels[self._known(name, self._labels)]
        labels = {cell: as_label(cell, self._form.decimal) for cell in set(cells)}
        return [labels[cell] for cell in cells]

    def _known(self, name: str | int, kept: Iterable[int]) -> int:
        """Index of a column that was asked for.

        Raises
        ------
        MissingColumn : the table has no such column, or several of that name.
        """
        if isinstance(name, str) and self._names.count(name) > 1:
            raise MissingColumn(f"{self.path}: the header has {name!r} {self._names.count(name)} times; give its index")
        at = self._at(name, max(len(self._names), *kept, 0) + 1)
        if at is None or at not in kept:
            has = ", ".join(self._names) if self._names else "no header"
            hint = "; is csv.delimiter right?" if len(self._names) == 1 else ""
            raise MissingColumn(f"{self.path} has no column {name!r}; it has {has}{hint}")
        return at

    def field(self, name: str | int) -> float | str:
        """The value of a column that never changes."""
        values = self.column(name, None)
        different = set(values) if isinstance(values, list) else set(values[np.isfinite(values)].tolist())
        if len(different) != 1:
            raise MissingColumn(f"{self.path}: column {name!r} holds {len(different)} values where one was expected")
        only = different.pop()
        return only if isinstance(only, str) else float(only)

    def place(self, name: str | int, row: int) -> str:
        """File, line and column for messages."""
        return f"{self.path}: line {self._lines[row]}, column {name!r}"

    def tables(self) -> list[ListedTable]:
        """One table of the columns of numbers, named by header, or by index if the header is missing or not unique."""
        alike = {name: self._names.count(name) for name in self._names}
        listed = []
        for at, cells in sorted(self._columns.items()):
            name = self._names[at] if at < len(self._names) else ""
            texts = [str(cell) for cell in cells]
            if all(map(self._is_number, texts)) and not all(text in self._form.missing for text in texts):
                listed.append(ListedColumn(name if alike.get(name) == 1 and name else at))
        return [ListedTable(None, tuple(listed))]

    def _is_number(self, cell: str) -> bool:
        if cell in self._form.missing or cell.lower() in ("true", "false"):
            return True
        try:
            float(cell.replace(self._form.decimal, "."))
        except ValueError:
            return False
        return True
