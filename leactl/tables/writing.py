"""Write text tables in the dialects of other programs, for the emulators of these programs."""

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
    """Format in which a program writes its tables."""

    encoding: str = "utf-8"
    byte_order_mark: bool = False
    delimiter: str = ","
    decimal: str = "."
    thousands: str = ""
    decimals: int = 2  # digits after the decimal mark
    missing: str = "--"  # text of a missing sample
    line_end: str = "\r\n"
    sep_line: bool = False  # whether `sep=,` stands before the table
    trailing: bool = False  # whether each row ends in a delimiter

    @classmethod
    def of(cls, form: TableFormat, decimals: int = 2) -> Self:
        """Return the dialect of the settings of a table; a setting that is None has the default of the dialect."""
        stated = form.model_dump(include={"encoding", "delimiter", "decimal", "thousands"}, exclude_none=True)
        return cls(decimals=decimals, **stated)

    def number(self, value: float) -> str:
        """Return a number in this dialect; NaN becomes the text of a missing sample."""
        if math.isnan(value):
            return self.missing
        return f"{value:,.{self.decimals}f}".translate({ord(","): self.thousands, ord("."): self.decimal})

    def row(self, cells: Sequence[str]) -> str:
        """Return one line of a table; a cell that contains a delimiter or a quote is quoted."""
        line = StringIO()
        writer = csv.writer(line, delimiter=self.delimiter, lineterminator=self.line_end)
        writer.writerow([*cells, ""] if self.trailing else cells)
        return line.getvalue()

    def head(self) -> str:
        """Return the `sep=` line before the table; empty if the dialect has none."""
        return f"sep={self.delimiter}{self.line_end}" if self.sep_line else ""

    def encoded(self, text: str, is_first: bool) -> bytes:
        """Return a part of the file as bytes; the first part (`is_first`) gets the byte order mark of the dialect."""
        mark = "\ufeff" if is_first and self.byte_order_mark else ""
        return (mark + text).encode(self.encoding)


def new_export(folder: Path, name: str) -> Path:
    """Return the first unused path of `name-1.csv`, `name-2.csv` and so on in a folder, which is created if absent."""
    folder.mkdir(parents=True, exist_ok=True)
    number = 1
    while (path := folder / f"{name}-{number}.csv").exists():
        number += 1
    return path
