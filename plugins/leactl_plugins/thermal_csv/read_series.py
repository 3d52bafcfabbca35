"""Read a table of regions over time: one row per frame, with columns named by the user."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.tables.number_format import CellLocator, NumberFormat, Numbers, read_numbers, split_cell
from leactl.tables.text_table import MOST_FAULTS, Aside, Table, common_unit, read_table, unit_of
from leactl.units import converter
from leactl_plugins.thermal_csv.settings import ThermalCsvSettings, unit_named
from leactl_plugins.thermal_csv.stamps import RowTimes, looks_plain, read_frames, read_plain, read_stamps

Array = npt.NDArray[np.float64]
LOWEST_READING, HIGHEST_READING = -460.0, 6000.0  # of a camera, in any unit of temperature
ABSOLUTE_ZERO_DEGC, ZERO_TOLERANCE_K = -273.15, 0.01  # the tolerance covers the rounding of a number at absolute zero
HOT_DEGC = 200.0  # above the temperature of any part of an actuator, and below room temperature in kelvin
RANGE_MARGIN = 10.0  # on both sides of the range of the surrounding numbers, in any unit
LEAST_USUAL_NUMBERS = 2  # numbers with a decimal mark; with fewer, others are not compared
EMISSIVITY = re.compile(r"emissivity|emissivit|emissionsgrad|发射率|辐射率|\bε", re.IGNORECASE)
UNIT_LINE = re.compile(r"^(temperature\s*)?units?$|^temp\w*\s*unit|单位|単位|단위", re.IGNORECASE)


class CameraFile(NamedTuple):
    """Content of one file, in the order of its rows."""

    clock: RowTimes
    values: Array  # (rows, regions), degC
    where: Callable[[int], str]  # names the place of a row in the file
    remarks: list[str]


def read_series(path: Path, settings: ThermalCsvSettings) -> CameraFile:
    """Read one file of a series.

    Raises
    ------
    InputError : the file has faults or is ambiguous.
    """
    time_settings = settings.time
    stamp_columns = [name for name in (time_settings.date_column, time_settings.column) if name is not None]
    regions = [str(region.column) for region in settings.regions.values()]
    table = read_table(path, settings, [*stamp_columns, *regions], every_row=not stamp_columns)
    headings = dict(zip(settings.regions, map(table.heading, regions), strict=True))
    cells = {heading: table.column(heading) for heading in headings.values()}
    stamps = [" ".join(parts).strip() for parts in zip(*map(table.column, stamp_columns), strict=True)]
    are_plain = not stamps or looks_plain(stamps[0])
    bounds = dict.fromkeys(cells, (LOWEST_READING, HIGHEST_READING))
    time_heading = table.heading(time_settings.column) if time_settings.column else ""
    if are_plain and stamps:
        cells[time_heading] = stamps
    numbers_by_heading, number_format = read_numbers(cells, settings, table.location, bounds)
    remarks = [*table.remarks, str(number_format)]

    def where(row: int) -> str:
        return table.location(time_heading or table.headings[0], row)

    plain_numbers = numbers_by_heading[time_heading] if are_plain and stamps else None
    clock = row_times(len(table.rows), stamps, plain_numbers, time_heading, settings, where)
    numbers_by_region = {name: numbers_by_heading[heading] for name, heading in headings.items()}
    unit = unit_in(path, settings, headings, numbers_by_region, table.asides)
    remarks += [f"temperatures in {unit}", clock.description, *missing_remarks(headings, numbers_by_region)]
    if table.repeated_headers:
        remarks.append(f"{table.repeated_headers + 1} blocks under the same headings")
    remarks += emissivity_remarks(table.asides) + emissivity_column_remarks(table)
    celsius_by_heading = {
        headings[name]: checked_celsius(headings[name], numbers.values, unit, table.location)
        for name, numbers in numbers_by_region.items()
    }
    values = np.stack([celsius_by_heading[headings[name]] for name in numbers_by_region], axis=1)
    region_cells = {heading: cells[heading] for heading in headings.values()}
    surrounding_cells = {text for column_cells in region_cells.values() for text in column_cells}
    remarks += odd_number_remarks(region_cells, surrounding_cells, number_format, table.location)
    remarks += heat_remarks(celsius_by_heading, unit, table.location)
    return CameraFile(clock, values, where, remarks)


def row_times(
    row_count: int,
    stamps: Sequence[str],
    plain_numbers: Numbers | None,
    heading: str,
    settings: ThermalCsvSettings,
    where: Callable[[int], str],
) -> RowTimes:
    """Return the times of rows from plain numbers if given, else from stamps, else from the numbers of frames."""
    if plain_numbers is not None:
        unit = common_unit(heading, plain_numbers.units, where(0))
        return read_plain(plain_numbers.values, unit, settings.time, heading, where)
    if stamps:
        return read_stamps(stamps, settings.time, where)
    return read_frames(np.arange(row_count, dtype=np.float64), settings.time, where)


def unit_in(
    path: Path,
    settings: ThermalCsvSettings,
    headings: Mapping[str, str],
    columns: Mapping[str, Numbers],
    asides: list[Aside],
) -> str:
    """Return the temperature unit of a file, from headings, cells, a line above the table, or the settings.

    Raises
    ------
    InputError : no unit or several units are named, or a cell names another unit than one of temperature.
    """
    sources_by_unit: dict[str, str] = {}
    for name, heading in headings.items():
        unit = unit_named(unit_of(heading)) or unit_after_slash(heading)
        if unit:
            sources_by_unit.setdefault(unit, f"heading {heading!r}")
        for unit_text in filter(None, columns[name].units):
            cell_unit = unit_named(unit_text)
            if cell_unit is None:
                raise InputError(f"{path}: column {heading!r}: {unit_text!r} behind a number is no temperature unit")
            sources_by_unit.setdefault(cell_unit, f"cells of {heading!r}")
    for aside in asides:
        unit = unit_named(aside.value) or unit_named(unit_of(aside.value))
        if UNIT_LINE.search(aside.name) and unit:
            sources_by_unit.setdefault(unit, f"line {aside.line}")
    if settings.unit is not None:
        sources_by_unit.setdefault(settings.unit, "the setting unit")
    if len(sources_by_unit) > 1:
        message = ", ".join(f"{unit} by {source}" for unit, source in sources_by_unit.items())
        raise InputError(f"{path}: several temperature units: {message}")
    if not sources_by_unit:
        raise InputError(f"{path}: no heading, cell or line names the temperature unit; unit decides")
    return next(iter(sources_by_unit))


def unit_after_slash(heading: str) -> str | None:
    """Return the unit of a heading such as `T1/K` or `T1 °C`; None if it names none."""
    return unit_named(re.split(r"[/_ ]", heading)[-1]) if re.search(r"/|°|℃|℉|deg[CF]$", heading) else None


def checked_celsius(name: str, values: Array, unit: str, location_of: CellLocator) -> Array:
    """Convert the temperatures of a column or a region to degC.

    Raises
    ------
    InputError : a temperature is not above absolute zero; its unit may be wrong, or it may mark a missing number.
    """
    conversion = converter(unit, "winding_temperature")
    assert conversion is not None
    converted: Array = conversion.factor * (values - conversion.zero)
    if (too_cold_rows := np.flatnonzero(converted <= ABSOLUTE_ZERO_DEGC + ZERO_TOLERANCE_K)).size:
        raise InputError(
            f"{location_of(name, int(too_cold_rows[0]))}: {values[too_cold_rows[0]]:.6g} {unit} is not above absolute"
            f" zero; unit says what numbers are in, missing which of them mark a missed sample"
        )
    return converted


def missing_remarks(headings: Mapping[str, str], columns: Mapping[str, Numbers]) -> list[str]:
    """Return remarks on missing and over-range cells, one for each column that has any."""
    remarks = []
    for name, numbers in columns.items():
        over_range = ", ".join(f"{mark} {count} times" for mark, count in numbers.over_range.items())
        missing_text = f"{numbers.missing_count} missing" if numbers.missing_count else ""
        if over_range or missing_text:
            remarks.append(f"{headings[name]}: {', '.join(filter(None, (missing_text, over_range)))}: NaN")
    return remarks


def odd_number_remarks(
    columns: Mapping[str, Sequence[str]],
    surrounding_cells: Iterable[str],
    number_format: NumberFormat,
    location_of: CellLocator,
) -> list[str]:
    """Return remarks on numbers that are far from the surrounding ones and written differently.

    Such a number has an exponent, or would be in their range if it had their decimal mark.

    Parameters
    ----------
    columns : cells by heading.
    surrounding_cells : the cells around them, and themselves.
    """
    usual_numbers = [
        text for text in map(number_in, surrounding_cells) if number_format.decimal in text and "e" not in text
    ]
    if len(usual_numbers) < LEAST_USUAL_NUMBERS:
        return []
    decimal_counts = {len(text.rpartition(number_format.decimal)[2]) for text in usual_numbers}
    values = [value for text in usual_numbers if (value := number_format.value(text)) is not None]
    low, high = min(values) - RANGE_MARGIN, max(values) + RANGE_MARGIN
    remarks = []
    for heading, cells in columns.items():
        for text in dict.fromkeys(cells):
            number = number_in(text)
            value = number_format.value(number) if number else None
            if value is None or low <= value <= high:
                continue
            has_lost_mark = number_format.decimal not in number and any(
                low <= value / 10.0**count <= high for count in decimal_counts
            )
            if has_lost_mark or "e" in number:
                reason = "has an exponent" if "e" in number else "may have lost its decimal mark"
                remarks.append(f"{location_of(heading, cells.index(text))}: {text!r} {reason}")
    return remarks[:MOST_FAULTS]


def number_in(text: str) -> str:
    """Return the number in a cell, in lower case; empty if there is none."""
    cell = split_cell(text, frozenset())
    return cell.number.lower() if cell else ""


def heat_remarks(columns: Mapping[str, Array], unit: str, location_of: CellLocator) -> list[str]:
    """Return a remark if all temperatures, or some, are above those of any part of an actuator.

    Parameters
    ----------
    columns : temperatures [degC] by heading or region.
    unit : unit of the temperatures in the file.
    """
    coldest = min(float(np.nanmin(values, initial=np.inf)) for values in columns.values())
    if HOT_DEGC < coldest < np.inf:
        other_units = "in kelvin, or counts" if unit == "degC" else "in another unit, or counts"
        return [f"no temperature is below {coldest:.4g} degC: are they {other_units}? unit decides"]
    hot_rows = {name: np.flatnonzero(values > HOT_DEGC) for name, values in columns.items()}
    first_hot = next((name for name, rows in hot_rows.items() if rows.size), None)
    if first_hot is None:
        return []
    row = int(hot_rows[first_hot][0])
    return [
        f"{location_of(first_hot, row)}: {columns[first_hot][row]:.4g} degC, and"
        f" {sum(rows.size for rows in hot_rows.values()) - 1} more above {HOT_DEGC:g} degC: do they mark a missed"
        " sample? missing decides"
    ]


def emissivity_remarks(asides: list[Aside]) -> list[str]:
    """Return a remark on the camera's emissivity and its changes; none if the file does not state it."""
    emissivity_lines = [aside for aside in asides if EMISSIVITY.search(aside.name)]
    changes = [
        aside for k, aside in enumerate(emissivity_lines) if k == 0 or aside.value != emissivity_lines[k - 1].value
    ]
    if not changes:
        return []
    first, *later = changes
    later_values = "".join(f"; from line {aside.line} on it is {aside.value}" for aside in later)
    return [f"emissivity {first.value}{later_values and ' CHANGES'}{later_values}"]


def emissivity_column_remarks(table: Table) -> list[str]:
    """Return remarks on columns of emissivities and their changes."""
    remarks = []
    for column, heading in enumerate(table.headings):
        if EMISSIVITY.search(heading):
            cells = [row[column].strip() for row in table.rows]
            changed_rows = [k for k in range(1, len(cells)) if cells[k] != cells[k - 1]]
            changes_text = "".join(f"; from line {table.lines[k]} on it is {cells[k]}" for k in changed_rows[:5])
            remarks.append(f"{heading} {cells[0]}{changes_text and ' CHANGES'}{changes_text}")
    return remarks
