"""Define the contract between the import and a file format: which columns and values a source returns.

Numbers are float64, missing ones NaN, true and false 1 and 0. No text of a file is ever evaluated as code.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from leactl.tables.columns import CsvForm

Array = npt.NDArray[np.float64]
LONGEST_REASON = 200  # characters of a library's error in a message


class MissingColumn(Exception):
    """The source has no such column or field; the message lists those that it has."""


def reason_text(error: BaseException) -> str:
    """Return the message of a library's error on one line, cut to `LONGEST_REASON` characters."""
    return " ".join(str(error).split())[:LONGEST_REASON] or type(error).__name__


def as_float(value: Any) -> float:
    """Convert a number to float.

    Raises
    ------
    MissingColumn : a whole number of more than 308 digits, as JSON may hold.
    """
    try:
        return float(value)
    except OverflowError:
        raise MissingColumn("holds a number beyond any float") from None


class WantedColumn(NamedTuple):
    """A column or field that the import will read."""

    name: str | int
    records: str | None = None


@dataclass(frozen=True)
class SourceRequest:
    """Columns and labels that the import will read from a source, so that only these of a large file take memory.

    Parameters
    ----------
    columns : columns that will be read; None for a survey, which only calls `tables`.
    labels : columns that will be read as labels; they may also be in `columns`.
    csv : form of a table of text.
    """

    columns: Sequence[WantedColumn] | None
    labels: Sequence[WantedColumn] = ()
    csv: CsvForm = field(default_factory=CsvForm)


class ListedColumn(NamedTuple):
    """A column of numbers of a file, with the units that the file itself declares."""

    name: str | int
    units: str = ""
    declared_by: str = ""  # where the file declares the units
    quantity: str = ""  # declared by the file, as are the following fields
    role: str = ""
    location: str = ""
    device: str = ""
    sampling: str = ""
    why_unnamed: str = ""  # reason why it is addressed by index although the file has headers


class ListedTable(NamedTuple):
    """Columns with common rows, which can become one stream of a mapping."""

    records: str | None
    columns: tuple[ListedColumn, ...]
    kind: str = ""  # type of the messages, if the file has one
    time: ListedColumn | None = None  # the column of stamps, if the format defines one
    joints: tuple[str, ...] = ()  # names that may replace `{joint}` in `records`
    run: tuple[tuple[str, str | bool], ...] = ()  # root attributes of the run that the file declares
    left_out: tuple[tuple[str | int, str], ...] = ()  # names of columns that cannot be read as numbers, and the reasons


class LogSource(Protocol):
    """One opened file of another program."""

    path: Path
    began: datetime | None  # start of the recording, if the file has it
    remarks: Sequence[str]  # what was left out of the file, for a person to check

    def column(self, name: str | int, records: str | None) -> Array | list[str]:
        """Return a column: numbers, or texts if it holds any text."""

    def labels(self, name: str | int, records: str | None) -> list[str]:
        """Return a column as labels, whether it holds numbers or text."""

    def field(self, name: str | int) -> float | str:
        """Return a single value."""

    def location(self, name: str | int, row: int) -> str:
        """Return file, column and row for messages."""

    def tables(self) -> list[ListedTable]:
        """Return all tables that a mapping could use."""
