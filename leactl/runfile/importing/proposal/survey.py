"""Survey a source without a mapping: all its columns of numbers, and the program that wrote it if it is recognised."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.runfile.importing.mapping import PLACEHOLDER, TimeBase
from leactl.runfile.importing.proposal.log_dialects import LogDialect, csv_forms, dialect_of
from leactl.runfile.importing.sources.registry import format_of, open_source
from leactl.runfile.importing.sources.source import ListedTable, MissingColumn, SourceRequest, WantedColumn
from leactl.runfile.importing.streams import seconds
from leactl.tables.columns import CsvForm
from leactl.tables.text_table import SEP_LINE, open_text

Array = npt.NDArray[np.float64]
MOST_JOINTS: Final = 4  # joints of a table whose values are read
LONGEST_SEP_LINE: Final = 20  # characters of the first line that are searched for `sep=`


@dataclass
class SurveyedTable:
    """A table with its values, for each surveyed joint."""

    table: ListedTable
    dialect: LogDialect | None
    columns: list[dict[str | int, Array]]


@dataclass
class Survey:
    """All tables of a source."""

    path: Path
    format: str
    csv: CsvForm
    tables: list[SurveyedTable]


def survey(path: Path) -> Survey:
    """Read every column of numbers of a source.

    Raises
    ------
    InputError : the source cannot be read, or has no column of numbers.
    """
    name = format_of(path)
    form, tables = tables_of(path, name)
    wanted = [
        WantedColumn(*fill_joint(column.name, table.records, joint))
        for table in tables
        for joint in joints_surveyed(table)
        for column in ((*table.columns, table.time) if table.time else table.columns)
    ]
    source = open_source(path, name, SourceRequest(wanted, csv=form))
    surveyed_tables = []
    for table in tables:
        by_joint: list[dict[str | int, Array]] = []
        for joint in joints_surveyed(table):
            by_joint.append({})
            for column in (*table.columns, *([table.time] if table.time else [])):
                try:
                    values = source.column(*fill_joint(column.name, table.records, joint))
                except MissingColumn:
                    continue  # this joint lacks the column, or the column has no number
                if table.time is not None and column.name == table.time.name and table.time.units == "iso8601":
                    values = seconds(source, TimeBase(column=column.name, units="iso8601"), values)
                if not isinstance(values, list):
                    by_joint[-1][column.name] = values
        surveyed_tables.append(SurveyedTable(table, dialect_of(table), by_joint))
    return Survey(path, name, form, surveyed_tables)


def tables_of(path: Path, name: str) -> tuple[CsvForm, list[ListedTable]]:
    """Return the tables of a source; a text file is read in the CSV form under which most columns are numbers.

    Raises
    ------
    InputError : it has no table of numbers.
    """
    best_reading: tuple[CsvForm, list[ListedTable]] = CsvForm(), []
    faults: list[str] = []
    for form in csv_forms(declared_delimiter(path)) if name == "csv" else [CsvForm()]:
        try:
            tables = open_source(path, name, SourceRequest(None, csv=form)).tables()
        except InputError as fault:
            faults += fault.faults
            continue
        if column_counts(tables) > column_counts(best_reading[1]):
            best_reading = form, tables
    if not any(table.columns for table in best_reading[1]):
        raise InputError(faults[:1] or f"{path}: no table of numbers that a mapping could take")
    return best_reading


def declared_delimiter(path: Path) -> str:
    """Return the delimiter that the first line of a text declares, as spreadsheets do (`sep=;`); else empty."""
    with open_text(path, CsvForm().encoding, advice="; csv.encoding decides") as file:
        match = SEP_LINE.match(file.readline(LONGEST_SEP_LINE))
    return match[1] if match else ""


def column_counts(tables: list[ListedTable]) -> tuple[int, int]:
    """Return the numbers of named columns and of all columns; a wrong delimiter splits the header unlike the rows."""
    columns = [column for table in tables for column in table.columns]
    return sum(isinstance(column.name, str) for column in columns), len(columns)


def joints_surveyed(table: ListedTable) -> tuple[str, ...]:
    """Return the names of the joints whose values are read; ("",) if a table has no joints."""
    return table.joints[:MOST_JOINTS] or ("",)


def fill_joint(column: str | int, records: str | None, joint: str) -> tuple[str | int, str | None]:
    """Return the name and records of a column with `{joint}` replaced by a joint's name."""
    name = column.replace(PLACEHOLDER, joint) if isinstance(column, str) else column
    return name, records.replace(PLACEHOLDER, joint) if records else None
