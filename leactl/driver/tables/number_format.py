"""How a text table of another program is written, and numbers out of its cells: every reading there is, never a guess.

A cell such as `1,234` has two readings. Those of all cells of a file are held against each other; where more than one
is left and they differ, the file is refused and the setting named that decides.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import StringConstraints, model_validator

from leactl.driver.contract import DriverSettings
from leactl.errors import InputError

Array = npt.NDArray[np.float64]
SPACES = str.maketrans({"\u00a0": " ", "\u202f": " ", "\u2009": " ", "\u2212": "-", "\u2019": "'"})
CELL = re.compile(
    r"(?P<outside>[<>]=?\s*)?"
    r"(?P<number>[+-]?(?:[0-9][0-9.,' ]*|[.,][0-9]+)(?:[eE][+-]?[0-9]+)?)\s*"
    r"(?P<unit>[^\d\s.,'+<>-][^\d<>]*)?"
)
THOUSANDS = (",", ".", " ", "'")
Where = Callable[[str, int], str]  # heading and row
Mark = Annotated[str, StringConstraints(strict=True)]


class TableFormat(DriverSettings):
    """How the file is written; what is left out is found in the file, or refused where it cannot be."""

    encoding: Literal["utf-8", "utf-16", "utf-16-le", "utf-16-be", "gbk", "cp1252"] | None = None
    delimiter: Literal[",", ";", "\t", "|"] | None = None
    decimal: Literal[".", ","] | None = None
    thousands: Literal["", ",", ".", " ", "'"] | None = None
    missing: tuple[Mark, ...] = ("", "-", "--", "---", "nan", "NaN", "NAN", "N/A", "n/a", "null")

    @model_validator(mode="after")
    def _marks_differ(self) -> "TableFormat":
        if self.decimal is not None and self.decimal in (self.thousands, self.delimiter):
            raise ValueError(f"decimal {self.decimal!r} is the thousands mark or the delimiter as well")
        return self


class NumberFormat(NamedTuple):
    """Decimal and thousands marks of a file."""

    decimal: str
    thousands: str

    def value(self, text: str) -> float | None:
        """What the text says; None where it is no number of this convention."""
        mantissa, _, exponent = text.replace("E", "e").partition("e")
        sign = -1.0 if mantissa.startswith("-") else 1.0
        whole, mark, fraction = mantissa.lstrip("+-").strip().partition(self.decimal)
        if self.thousands and self.thousands in whole:
            groups = whole.split(self.thousands)
            if not 1 <= len(groups[0]) <= 3 or groups[0][0] == "0" or any(len(group) != 3 for group in groups[1:]):
                return None
            whole = "".join(groups)
        digits = whole + fraction
        if not (digits.isascii() and digits.isdigit()):
            return None
        return sign * float(f"{whole or '0'}{'.' + fraction if mark and fraction else ''}e{exponent or '0'}")

    def __str__(self) -> str:
        kinds = {"": "no thousands mark", " ": "a space between thousands"}
        return f"decimal {self.decimal!r}, {kinds.get(self.thousands, f'thousands {self.thousands!r}')}"


class NumberCell(NamedTuple):
    """A cell taken apart; `number` is empty where nothing was measured."""

    number: str
    unit: str = ""
    outside: str = ""  # ">" or "<": the sensor's range ends there


class Numbers(NamedTuple):
    """The numbers of one column."""

    values: Array  # NaN where missing or out of range
    units: tuple[str, ...]  # that stand in its cells; "" for cells without
    missing: int
    outside: dict[str, int]  # over-range marks as they stand, and how often


def take_apart(text: str, missing: frozenset[str]) -> NumberCell | None:
    """The parts of a cell; None where it is neither a number nor a mark of nothing."""
    plain = text.translate(SPACES).strip()
    if plain in missing:
        return NumberCell("")
    found = CELL.fullmatch(plain)
    if found is None:
        return None
    return NumberCell(found["number"].strip(), (found["unit"] or "").strip(), (found["outside"] or "")[:1])


def read_numbers(
    columns: Mapping[str, Sequence[str]],
    form: TableFormat,
    place: Where,
    bounds: Mapping[str, tuple[float, float]],
) -> tuple[dict[str, Numbers], NumberFormat]:
    """The numbers of columns of text that were written in one convention.

    Parameters
    ----------
    columns : cells by heading.
    place : says where a row of a column stands.
    bounds : lowest and highest value that a column can hold, where that is known, to tell readings apart.

    Raises
    ------
    InputError : a cell that is no number, no convention that reads all, or several that read them differently.
    """
    missing = frozenset(mark.translate(SPACES).strip() for mark in form.missing)
    parts: dict[str, dict[str, NumberCell]] = {}
    faults: list[str] = []
    for heading, cells in columns.items():
        parts[heading] = {}
        for text in dict.fromkeys(cells):
            cell = take_apart(text, missing)
            if cell is not None:
                parts[heading][text] = cell
            elif len(faults) < 5:
                told = f"{text!r} is not a number; if it marks a missed sample, add it to missing"
                faults.append(f"{place(heading, cells.index(text))}: {told}")
    if faults:
        raise InputError(faults)
    readings = [
        (convention, values)
        for convention in conventions(form, parts)
        if (values := read_as(convention, parts, bounds)) is not None
    ]
    if not readings:
        raise InputError(unreadable(columns, form, parts, place, bounds))
    convention, values = readings[0]
    for other, different in readings[1:]:
        refuse_difference(columns, place, (convention, values), (other, different))
    return {heading: numbers(cells, parts[heading], values[heading]) for heading, cells in columns.items()}, convention


def conventions(form: TableFormat, parts: Mapping[str, Mapping[str, NumberCell]]) -> Iterator[NumberFormat]:
    """Those that the settings allow; a mark that stands nowhere makes no convention of its own."""
    used = set("".join(cell.number for cells in parts.values() for cell in cells.values()))
    for decimal in (".", ",") if form.decimal is None else (form.decimal,):
        for thousands in ("", *THOUSANDS) if form.thousands is None else (form.thousands,):
            if thousands != decimal and (thousands in used or not thousands or form.thousands is not None):
                yield NumberFormat(decimal, thousands)


def read_as(
    convention: NumberFormat,
    parts: Mapping[str, Mapping[str, NumberCell]],
    bounds: Mapping[str, tuple[float, float]],
) -> dict[str, dict[str, float]] | None:
    """Every distinct cell in this convention; None where one of them is no number, or cannot be."""
    read: dict[str, dict[str, float]] = {}
    for heading, cells in parts.items():
        low, high = bounds.get(heading, (-np.inf, np.inf))
        column = read[heading] = {}
        for text, cell in cells.items():
            if not cell.number:
                column[text] = np.nan
                continue
            value = convention.value(cell.number)
            if value is None or not low <= value <= high:
                return None
            column[text] = value
    return read


def refuse_difference(
    columns: Mapping[str, Sequence[str]],
    place: Where,
    one: tuple[NumberFormat, Mapping[str, Mapping[str, float]]],
    other: tuple[NumberFormat, Mapping[str, Mapping[str, float]]],
) -> None:
    """Refuse a file that two conventions read differently, with the first cell where they do."""
    for heading, cells in columns.items():
        for text, value in one[1][heading].items():
            second = other[1][heading][text]
            if value != second and not np.isnan(value):
                where = place(heading, cells.index(text))
                key = "decimal" if one[0].decimal != other[0].decimal else "thousands"
                raise InputError(f"{where}: {text!r} reads {value:.15g} or {second:.15g}; {key} decides")


def unreadable(
    columns: Mapping[str, Sequence[str]],
    form: TableFormat,
    parts: Mapping[str, Mapping[str, NumberCell]],
    place: Where,
    bounds: Mapping[str, tuple[float, float]],
) -> str:
    """Why no convention reads every cell: the one that comes furthest, and where it ends."""
    furthest, told = -1, ""
    for convention in conventions(form, parts):
        passed = 0
        for heading, cells in parts.items():
            low, high = bounds.get(heading, (-np.inf, np.inf))
            for text, cell in cells.items():
                value = convention.value(cell.number) if cell.number else 0.0
                if value is None or (cell.number and not low <= value <= high):
                    if passed > furthest:
                        why = "is no number" if value is None else f"is {value:g}, outside {low:g} to {high:g},"
                        furthest = passed
                        told = f"{place(heading, columns[heading].index(text))}: {text!r} {why} with {convention}"
                    break
                passed += 1
            else:
                continue
            break
    return f"{told}; no decimal and thousands mark reads every number of the file"


def numbers(cells: Sequence[str], parts: Mapping[str, NumberCell], values: Mapping[str, float]) -> Numbers:
    """The column, its over-range marks turned into NaN and counted."""
    marks = {text for text, cell in parts.items() if cell.outside}
    nothing = {text for text, cell in parts.items() if not cell.number}
    known = {text: np.nan if text in marks else value for text, value in values.items()}
    outside: dict[str, int] = {}
    missing = 0
    if marks or nothing:
        for text in cells:
            if text in marks:
                outside[text.strip()] = outside.get(text.strip(), 0) + 1
            missing += text in nothing
    units = tuple(sorted({cell.unit for cell in parts.values() if cell.number}))
    return Numbers(np.array([known[text] for text in cells], np.float64), units, missing, outside)
