"""Settings of a text table, and its numbers; decimal and thousands marks are detected only if they are unambiguous.

A cell such as `1,234` can be read in two ways. A number format has to read all cells of a file. If several formats read
all cells and give different values, the file is refused, and the message names the setting that decides.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from io import BytesIO, TextIOWrapper
from typing import Annotated, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import StringConstraints, field_validator, model_validator

from leactl.errors import InputError
from leactl.yamlblock import Block

Array = npt.NDArray[np.float64]
# applied to each cell before it is read: special spaces, minus sign and apostrophe become their ASCII characters
PLAIN_CHARACTERS = str.maketrans({"\u00a0": " ", "\u202f": " ", "\u2009": " ", "\u2212": "-", "\u2019": "'"})
CELL = re.compile(
    r"(?P<over_range>[<>]=?\s*)?"
    r"(?P<number>[+-]?(?:[0-9][0-9.,' ]*|[.,][0-9]+)(?:[eE][+-]?[0-9]+)?)\s*"
    r"(?P<unit>[^\d\s.,'+<>-][^\d<>]*)?"
)
THOUSANDS = (",", ".", " ", "'")
MOST_FAULTS = 5  # cells that one message names
CellLocator = Callable[[str, int], str]  # returns file, line and column of a cell by heading and row
MissingMark = Annotated[str, StringConstraints(strict=True)]
Character = Annotated[str, StringConstraints(strict=True, min_length=1, max_length=1)]


class TableFormat(Block):
    """Settings of a text table: any encoding and delimiter; a setting that is None is detected."""

    encoding: str | None = None
    delimiter: Character | None = None
    decimal: Literal[".", ","] | None = None
    thousands: Literal["", ",", ".", " ", "'"] | None = None
    missing: tuple[MissingMark, ...] = ("", "-", "--", "---", "nan", "NaN", "NAN", "N/A", "n/a", "null")

    @field_validator("encoding")
    @classmethod
    def _known_encoding(cls, value: str | None) -> str | None:
        try:
            TextIOWrapper(BytesIO(), value)
        except LookupError:
            raise ValueError("the name of an encoding, such as utf-8 or cp1252, was expected") from None
        return value

    @model_validator(mode="after")
    def _marks_differ(self) -> "TableFormat":
        if self.decimal is not None and self.decimal in (self.thousands, self.delimiter):
            raise ValueError(f"decimal {self.decimal!r} is the thousands mark or the delimiter as well")
        return self


class DetectableFormat(TableFormat):
    """Settings of a text table of a record, limited to the encodings and delimiters that detection can find."""

    encoding: (
        Literal["utf-8", "utf-16", "utf-16-le", "utf-16-be", "cp1252", "gbk", "gb18030", "cp949", "shift_jis"] | None
    ) = None
    delimiter: Literal[",", ";", "\t", "|"] | None = None

    @model_validator(mode="after")
    def _marks_differ(self) -> "DetectableFormat":
        """Raise if the decimal mark is the thousands mark.

        It may equal the delimiter, as some programs write `25,3` as two comma-separated cells.
        """
        if self.decimal is not None and self.decimal == self.thousands:
            raise ValueError(f"decimal {self.decimal!r} is the thousands mark as well")
        return self


class NumberFormat(NamedTuple):
    """Decimal mark and thousands mark of a file."""

    decimal: str
    thousands: str

    def value(self, text: str) -> float | None:
        """Return the number in a text; None if the text is not a finite number in this format."""
        mantissa, _, exponent = text.replace("E", "e").partition("e")
        sign = -1.0 if mantissa.startswith("-") else 1.0
        whole, mark, fraction = mantissa[mantissa.startswith(("+", "-")) :].strip().partition(self.decimal)
        if self.thousands and self.thousands in whole:
            # 1,234,567: groups of three, and no leading group of 0, which begins a fraction
            groups = whole.split(self.thousands)
            if not 1 <= len(groups[0]) <= 3 or groups[0][0] == "0" or any(len(group) != 3 for group in groups[1:]):
                return None
            whole = "".join(groups)
        digits = whole + fraction
        if not (digits.isascii() and digits.isdigit()):
            return None
        value = sign * float(f"{whole or '0'}{'.' + fraction if mark and fraction else ''}e{exponent or '0'}")
        return value if math.isfinite(value) else None

    def __str__(self) -> str:
        kinds = {"": "no thousands mark", " ": "a space between thousands"}
        return f"decimal {self.decimal!r}, {kinds.get(self.thousands, f'thousands {self.thousands!r}')}"


class NumberCell(NamedTuple):
    """The parts of a cell; `number` is empty for a missing sample."""

    number: str
    unit: str = ""
    over_range: str = ""  # ">" or "<" before the number: the value is beyond the range of the sensor


class Numbers(NamedTuple):
    """The numbers of one column."""

    values: Array  # NaN where missing or out of range
    units: tuple[str, ...]  # distinct units in the cells; "" for cells without a unit
    missing_count: int
    over_range: dict[str, int]  # number of cells with each over-range text, such as ">150"


def split_cell(text: str, missing_marks: frozenset[str]) -> NumberCell | None:
    """Split a cell into its parts; return None if it is neither a number nor one of the marks for a missing sample."""
    plain = text.translate(PLAIN_CHARACTERS).strip()
    if plain in missing_marks:
        return NumberCell("")
    match = CELL.fullmatch(plain)
    if match is None:
        return None
    return NumberCell(match["number"].strip(), (match["unit"] or "").strip(), (match["over_range"] or "")[:1])


def read_numbers(
    columns: Mapping[str, Sequence[str]],
    form: TableFormat,
    locate_cell: CellLocator,
    bounds: Mapping[str, tuple[float, float]],
) -> tuple[dict[str, Numbers], NumberFormat]:
    """Read columns of text that share one number format; return their numbers by heading, and the format.

    Parameters
    ----------
    columns : cells by heading.
    locate_cell : returns file, line and column of a cell for messages.
    bounds : lowest and highest possible value of a column, by heading; a format that gives a value outside is excluded.

    Raises
    ------
    InputError : a cell is no number, no format reads all cells, or several formats give different values.
    """
    missing_marks = frozenset(mark.translate(PLAIN_CHARACTERS).strip() for mark in form.missing)
    cells_by_text: dict[str, dict[str, NumberCell]] = {}
    faults: list[str] = []
    for heading, cells in columns.items():
        cells_by_text[heading] = {}
        for text in dict.fromkeys(cells):
            cell = split_cell(text, missing_marks)
            if cell is not None:
                cells_by_text[heading][text] = cell
            elif len(faults) < MOST_FAULTS:
                message = f"{text!r} is not a number; if it marks a missed sample, add it to missing"
                faults.append(f"{locate_cell(heading, cells.index(text))}: {message}")
    if faults:
        raise InputError(faults)
    attempts = [
        (number_format, *read_in_format(number_format, cells_by_text, bounds))
        for number_format in possible_formats(form, cells_by_text)
    ]
    readings = [(number_format, values) for number_format, values, fault in attempts if not fault]
    if not readings:  # report the first faulty cell of the format that reads most cells
        number_format, _, fault = max(attempts, key=lambda attempt: sum(map(len, attempt[1].values())))
        heading, text, reason = fault
        location = locate_cell(heading, columns[heading].index(text))
        advice = "no combination of decimal and thousands mark reads every number of the file"
        raise InputError(f"{location}: {text!r} {reason} with {number_format}; {advice}")
    number_format, values = readings[0]
    for second_reading in readings[1:]:
        refuse_ambiguity(columns, locate_cell, readings[0], second_reading)
    return {
        heading: column_of_numbers(cells, cells_by_text[heading], values[heading]) for heading, cells in columns.items()
    }, number_format


def possible_formats(
    form: TableFormat, cells_by_text: Mapping[str, Mapping[str, NumberCell]]
) -> Iterator[NumberFormat]:
    """Yield the number formats that the settings allow; a detected thousands mark has to occur in a cell."""
    characters = set("".join(cell.number for cells in cells_by_text.values() for cell in cells.values()))
    for decimal in (".", ",") if form.decimal is None else (form.decimal,):
        for thousands in ("", *THOUSANDS) if form.thousands is None else (form.thousands,):
            if thousands != decimal and (thousands in characters or not thousands or form.thousands is not None):
                yield NumberFormat(decimal, thousands)


def read_in_format(
    number_format: NumberFormat,
    cells_by_text: Mapping[str, Mapping[str, NumberCell]],
    bounds: Mapping[str, tuple[float, float]],
) -> tuple[dict[str, dict[str, float]], tuple[str, ...]]:
    """Read the distinct cells of each column in one format.

    Returns
    -------
    The values by heading and text, up to the first cell that the format cannot read; and heading, text and fault of
    that cell, empty if all cells are read.
    """
    values: dict[str, dict[str, float]] = {}
    for heading, cells in cells_by_text.items():
        low, high = bounds.get(heading, (-np.inf, np.inf))
        column = values[heading] = {}
        for text, cell in cells.items():
            value = number_format.value(cell.number) if cell.number else np.nan
            if value is None:
                return values, (heading, text, "is no number")
            if cell.number and not low <= value <= high:
                return values, (heading, text, f"is {value:g}, outside {low:g} to {high:g},")
            column[text] = value
    return values, ()


def refuse_ambiguity(
    columns: Mapping[str, Sequence[str]],
    locate_cell: CellLocator,
    first: tuple[NumberFormat, Mapping[str, Mapping[str, float]]],
    second: tuple[NumberFormat, Mapping[str, Mapping[str, float]]],
) -> None:
    """Raise if two number formats read a file with different values.

    Parameters
    ----------
    first, second : a format, and the values that it gives by heading and text.

    Raises
    ------
    InputError : the first cell where the values differ, and the setting that decides.
    """
    for heading, cells in columns.items():
        for text, value in first[1][heading].items():
            second_value = second[1][heading][text]
            if value != second_value and not np.isnan(value):
                location = locate_cell(heading, cells.index(text))
                key = "decimal" if first[0].decimal != second[0].decimal else "thousands"
                raise InputError(f"{location}: {text!r} may be {value:.15g} or {second_value:.15g}; {key} decides")


def column_of_numbers(
    cells: Sequence[str], parsed_cells: Mapping[str, NumberCell], values: Mapping[str, float]
) -> Numbers:
    """Return the numbers of a column; over-range cells become NaN and are counted."""
    over_range_texts = {text for text, cell in parsed_cells.items() if cell.over_range}
    missing_texts = {text for text, cell in parsed_cells.items() if not cell.number}
    value_of = {text: np.nan if text in over_range_texts else value for text, value in values.items()}
    over_range: dict[str, int] = {}
    missing_count = 0
    if over_range_texts or missing_texts:
        for text in cells:
            if text in over_range_texts:
                over_range[text.strip()] = over_range.get(text.strip(), 0) + 1
            missing_count += text in missing_texts
    units = tuple(sorted({cell.unit for cell in parsed_cells.values() if cell.number}))
    return Numbers(np.array([value_of[text] for text in cells], np.float64), units, missing_count, over_range)
