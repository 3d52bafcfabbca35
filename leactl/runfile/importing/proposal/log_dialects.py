"""Read the documented log formats of known programs: quantity and unit of each column, one file in `dialects/` each."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import cache
from importlib import resources
from typing import Annotated, Literal

from pydantic import Field

from leactl import yamlfile
from leactl.runfile.importing.mapping import Above, Text
from leactl.runfile.importing.sources.source import ListedTable
from leactl.tables.columns import CsvForm
from leactl.yamlblock import Block


class DialectTime(Block):
    """The column of stamps."""

    column: Text
    units: Literal["s", "ms", "us", "ns"]


class DialectChannel(Block):
    """Quantity and units of a column."""

    column: Text  # pattern with `*`; the first matching entry counts
    quantity: str = ""  # empty: the column is no channel
    units: tuple[Text, ...] = ()  # the documented unit, or several if it depends on the program's settings
    scale: Above | None = None
    scale_of: str = ""  # description of the scale, if a person has to give it
    sign: Literal[1, -1] = 1
    location: str = ""


class LogDialect(Block):
    """Log format of one program."""

    meaning: Text  # name of the logs, used in the evidence
    source: Text  # documentation of columns and units
    kind: str = ""  # type of the messages by which it is recognised
    has: tuple[Text, ...] = ()  # patterns of columns by which it is recognised
    csv: CsvForm = CsvForm()
    time: DialectTime | None = None
    channels: Annotated[tuple[DialectChannel, ...], Field(min_length=1)]

    def speaks(self, table: ListedTable) -> bool:
        """Return whether a table was written by this program."""
        if self.kind:
            return table.kind == self.kind
        names = [str(column.name) for column in table.columns]
        return all(any(fnmatchcase(name, pattern) for name in names) for pattern in self.has)

    def channel(self, name: str) -> DialectChannel | None:
        """Return the entry of a column; None if the format does not describe it."""
        return next((channel for channel in self.channels if fnmatchcase(name, channel.column)), None)


@cache
def dialects() -> tuple[LogDialect, ...]:
    """Return all dialects, in the order of their file names."""
    folder = resources.files("leactl.runfile.importing.proposal") / "dialects"
    texts = {
        entry.name: entry.read_text(encoding="utf-8") for entry in folder.iterdir() if entry.name.endswith(".yaml")
    }
    return tuple(yamlfile.parse(texts[name], name).validate(LogDialect) for name in sorted(texts))


def dialect_of(table: ListedTable) -> LogDialect | None:
    """Return the dialect of a table; None if no program is recognised."""
    return next((dialect for dialect in dialects() if dialect.speaks(table)), None)


def csv_forms(declared: str = "") -> Sequence[CsvForm]:
    """Return the CSV forms to try on a table of text: those of the dialects, then those with the usual delimiters.

    Parameters
    ----------
    declared : delimiter that the first line of the text declares by `sep=`, with the header below it; empty if none.
    """
    if declared:
        return [
            CsvForm(delimiter=declared, decimal=decimal, header_line=2) for decimal in (".", ",") if decimal != declared
        ]
    decimal_point = [CsvForm(delimiter=delimiter) for delimiter in (",", ";", "\t", " ")]
    usual = [*decimal_point, *(CsvForm(delimiter=delimiter, decimal=",") for delimiter in (";", "\t"))]
    return list(dict.fromkeys([*(dialect.csv for dialect in dialects()), *usual]))
