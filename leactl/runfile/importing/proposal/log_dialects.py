"""Columns of programs whose logs are documented: what each measures and in which unit, a file of `dialects/` each."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import cache
from importlib import resources
from typing import Annotated, Literal

from pydantic import Field

from leactl import yamlfile
from leactl.runfile.importing.mapping import Above, CsvForm, Text
from leactl.runfile.importing.sources.source import ListedTable
from leactl.yamlblock import Block


class DialectTime(Block):
    """The column of stamps."""

    column: Text
    units: Literal["s", "ms", "us", "ns"]


class DialectChannel(Block):
    """What a column of a program measures."""

    column: Text  # `*` stands for anything; the first that fits counts
    quantity: str = ""  # empty: no channel
    units: tuple[Text, ...] = ()  # the one that is documented, or those among which its file does not decide
    scale: Above | None = None
    scale_of: str = ""  # what the scale is, where a person has to give it
    sign: Literal[1, -1] = 1
    location: str = ""


class LogDialect(Block):
    """How a program writes its logs."""

    meaning: Text  # what its logs are, as evidence tells it
    source: Text  # of its columns and units
    kind: str = ""  # type of the messages
    has: tuple[Text, ...] = ()  # columns by which it is recognised, of which `*` stands for anything
    csv: CsvForm = CsvForm()
    time: DialectTime | None = None
    channels: Annotated[tuple[DialectChannel, ...], Field(min_length=1)]

    def speaks(self, table: ListedTable) -> bool:
        """Whether a table is one of this program."""
        if self.kind:
            return table.kind == self.kind
        names = [str(column.name) for column in table.columns]
        return all(any(fnmatchcase(name, pattern) for name in names) for pattern in self.has)

    def channel(self, name: str) -> DialectChannel | None:
        """What it says of a column; None where it says nothing."""
        return next((channel for channel in self.channels if fnmatchcase(name, channel.column)), None)


@cache
def dialects() -> tuple[LogDialect, ...]:
    """Every dialect, by the names of their files."""
    folder = resources.files("leactl.runfile.importing.proposal") / "dialects"
    texts = {
        entry.name: entry.read_text(encoding="utf-8") for entry in folder.iterdir() if entry.name.endswith(".yaml")
    }
    return tuple(yamlfile.parse(texts[name], name).validate(LogDialect) for name in sorted(texts))


def dialect_of(table: ListedTable) -> LogDialect | None:
    """The dialect of a table; None where no program is recognised."""
    return next((dialect for dialect in dialects() if dialect.speaks(table)), None)


def csv_forms() -> Sequence[CsvForm]:
    """How tables of text are tried, until one has columns of numbers: as dialects write them, then by delimiter."""
    usual = [CsvForm(), CsvForm(delimiter=";"), CsvForm(delimiter="\t"), CsvForm(delimiter=";", decimal=",")]
    return list(dict.fromkeys([*(dialect.csv for dialect in dialects()), *usual]))
