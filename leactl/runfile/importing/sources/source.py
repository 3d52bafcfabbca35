"""Foreign files as something to ask for columns and single values: what a format gives, and what it is asked for.

Numbers come as float64; what is missing is NaN; true and false are 1 and 0. Nothing in a file is ever evaluated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from leactl.runfile.importing.mapping import CsvForm

Array = npt.NDArray[np.float64]
LONGEST_REASON = 200  # characters


class MissingColumn(Exception):
    """The source has no such column or field; the message says what it has."""


def reason_text(error: BaseException) -> str:
    """What a library says of a file, on one line and not for long."""
    return " ".join(str(error).split())[:LONGEST_REASON] or type(error).__name__


def as_float(value: Any) -> float:
    """A number as the run file keeps it.

    Raises
    ------
    Lacking : a whole number of more than 308 digits, as JSON may hold.
    """
    try:
        return float(value)
    except OverflowError:
        raise MissingColumn("holds a number beyond any float") from None


class WantedColumn(NamedTuple):
    """A column or field that will be asked for."""

    name: str | int
    records: str | None = None


@dataclass(frozen=True)
class SourceRequest:
    """What will be asked of a source, of which a large file keeps that alone.

    Parameters
    ----------
    columns : None where nobody knows yet what the source has: `tables` alone will be asked for.
    labels : columns that will be asked for as labels, whether they are among `columns` as well or not.
    """

    columns: Sequence[WantedColumn] | None
    labels: Sequence[WantedColumn] = ()
    csv: CsvForm = field(default_factory=CsvForm)


class ListedColumn(NamedTuple):
    """A column of numbers as its file lists it, with the units that the file itself declares."""

    name: str | int
    units: str = ""
    declared_by: str = ""  # where those units stand
    quantity: str = ""  # that the file itself declares


class ListedTable(NamedTuple):
    """Columns that share their rows, as a mapping's stream takes them."""

    records: str | None
    columns: tuple[ListedColumn, ...]
    kind: str = ""  # type of a message, where the file says it
    time: ListedColumn | None = None  # the column of stamps, where the format itself says which it is
    joints: tuple[str, ...] = ()  # that `{joint}` in `records` may stand for


class LogSource(Protocol):
    """One foreign file."""

    path: Path
    began: datetime | None  # when it was recorded, where the file says it

    def column(self, name: str | int, records: str | None) -> Array | list[str]:
        """A column: numbers, or text where it holds any."""

    def labels(self, name: str | int, records: str | None) -> list[str]:
        """A column as labels, whether it holds numbers or text."""

    def field(self, name: str | int) -> float | str:
        """A single value."""

    def place(self, name: str | int, row: int) -> str:
        """Where a row of a column stands, for messages."""

    def tables(self) -> list[ListedTable]:
        """Everything that a mapping could take."""
