"""Write text tables in the dialects of other programs, for their emulators."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Self

from leactl.tables.number_format import TableFormat


@dataclass(frozen=True)
class TableDialect:
    """How a program writes a table."""

    encoding: str = "utf-8"
    byte_order_mark: bool = False
    delimiter: str = ","
    decimal: str = "."
    thousands: str = ""
    decimals: int = 2
    missing: str = "--"
    line_end: str = "\r\n"
    sep_line: bool = False
    trailing: bool = False  # a delimiter at the end of each row

    @classmethod
    def of(cls, form: TableFormat, decimals: int = 2) -> Self:
        """The dialect that settings state, with the usual marks where they state none."""
        stated = form.model_dump(include={"encoding", "delimiter", "decimal", "thousands"}, exclude_none=True)
        return cls(decimals=decimals, **stated)

    def number(self, value: float) -> str:
        """A number in this dialect; NaN becomes the mark for a missing sample."""
        if math.isnan(value):
            return self.missing
        return f"{value:,.{self.decimals}f}".translate({ord(","): self.thousands, ord("."): self.decimal})

    def row(self, cells: Sequence[str]) -> str:
        """One line of a table; a cell that contains a delimiter or a quote is quoted."""
        line = StringIO()
        writer = csv.writer(line, delimiter=self.delimiter, lineterminator=self.line_end)
        writer.writerow([*cells, ""] if self.trailing else cells)
        return line.getvalue()

    def head(self) -> str:
        """The `sep=` line before the table, if the dialect has one."""
        return f"sep={self.delimiter}{self.line_end}" if self.sep_line else ""

    def encoded(self, text: str, begins: bool) -> bytes:
        """Encode a part of the file; the first part (`begins`) gets the byte order mark, if the dialect has one."""
        mark = "\ufeff" if begins and self.byte_order_mark else ""
        return (mark + text).encode(self.encoding)


def new_export(folder: Path, name: str) -> Path:
    """An unused path `name-1.csv`, `name-2.csv` and so on in a folder, which is created if absent."""
    folder.mkdir(parents=True, exist_ok=True)
    number = 1
    while (path := folder / f"{name}-{number}.csv").exists():
        number += 1
    return path
