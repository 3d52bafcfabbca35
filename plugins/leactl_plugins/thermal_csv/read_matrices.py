"""Read frames of pixels: one line per row, frames separated by blank lines or by lines with their time."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import numpy as np

from leactl.driver.file_records import refuse_text_order
from leactl.errors import InputError
from leactl.tables.number_format import read_numbers, split_cell
from leactl.tables.text_table import (
    DELIMITER_NAMES,
    DELIMITERS,
    SEP_LINE,
    Aside,
    cells_of,
    join_halves,
    read_text,
    rows_of,
    strip_cells,
)
from leactl_plugins.thermal_csv.read_series import (
    HIGHEST_READING,
    LOWEST_READING,
    Array,
    CameraFile,
    checked_celsius,
    emissivity_remarks,
    heat_remarks,
    missing_remarks,
    odd_number_remarks,
    row_times,
    unit_in,
)
from leactl_plugins.thermal_csv.settings import CameraRegion, ThermalCsvSettings
from leactl_plugins.thermal_csv.stamps import looks_plain

LETTER = re.compile(r"[^\W\d_]")
CELL_ENDS = re.compile(f"[{''.join(DELIMITERS)}]")
STATISTICS: dict[str, Callable[..., Array]] = {"mean": np.mean, "max": np.max, "min": np.min}
NAME_VALUE = re.compile(r"\s*([^:=]*?)\s*[:=]\s*(.*)")
FRAME_LABEL = re.compile(r"[^\W\d_]+\s*[0-9]+")  # `Frame 12`, in the first cell of the first row of a frame
SIZE_NAMES = (("height", "imageheight"), ("width", "imagewidth"))  # of rows and of columns, in lower case
LEAST_AXIS_LENGTH = 3  # cells that rise or fall evenly, from which on they are taken for an axis
MOST_ROUNDING_SHARE = 1 / 3  # largest rounding of an axis' numbers over its step
NUMBER = re.compile(r"[+-]?[0-9]+([.,][0-9]+)?")
PIXELS_HINT = "skip_lines, index_column and frame_size tell which cells are pixels"


@dataclass
class PixelFrame:
    """Unparsed lines of one frame, its first line, and the named values above it."""

    path: Path
    line: int
    delimiter: str
    rows: list[str] = field(default_factory=list)
    above: list[Aside] = field(default_factory=list)
    label: tuple[int, int] = (0, 0)  # line and number of cells of a labelled line above, which looks like a row
    size: tuple[int | None, int | None] = (None, None)  # rows and columns, as the file states them

    def cells(self, row: int) -> list[str]:
        """Cells of one row, with its number."""
        return split_line(self.rows[row], self.delimiter)


def read_matrices(paths: Sequence[Path], settings: ThermalCsvSettings) -> CameraFile:
    """Read the frames of one file or of several, in the order given.

    Raises
    ------
    InputError : no frames, frames of different sizes, regions outside them, or ambiguous stamps or numbers.
    """
    frames: list[PixelFrame] = []
    remarks: list[str] = []
    for path in paths:
        text, encoding = read_text(path, settings.encoding)
        lines = text.splitlines()
        delimiter = delimiter_of(path, lines, settings)
        if delimiter == settings.decimal:
            delimiter, lines = ";", join_halves(lines)
        remarks.append(f"{encoding}, {DELIMITER_NAMES.get(delimiter, repr(delimiter))} between cells")
        *file_frames, unfinished = frames_in(path, lines, delimiter, settings)
        if unfinished.rows:
            file_frames.append(unfinished)
        store_stated_size(file_frames, settings)
        remarks += text_line_remarks(file_frames, unfinished)
        frames += file_frames
        if not text.endswith(("\n", "\r")):
            remarks.append(f"{path.name} has no end of its last line: the last pixel may be cut")
    remarks = list(dict.fromkeys(remarks))
    if settings.time.line is None:
        refuse_text_order(paths)
    refuse_halves(frames, settings)
    frames, width, size_remarks = frames_of_one_size(frames, settings)
    check_first_cells(frames, settings)
    remarks += [f"{len(frames)} frames of {len(frames[0].rows)} rows and {width} columns", *size_remarks]

    def frame_location(row: int) -> str:
        return f"{frames[row].path}: the frame from line {frames[row].line} on"

    cells, row_cells = region_cells(frames, width, settings)
    cells_by_region = {
        name: [cell for frame in frames_of_region for cell in frame] for name, frames_of_region in cells.items()
    }
    sizes = {name: len(frames_of_region[0]) for name, frames_of_region in cells.items()}

    def location_of(name: str, cell: int) -> str:
        return f"{frame_location(cell // sizes[name])}, region {name}"

    numbers, convention = read_numbers(
        cells_by_region, settings, location_of, dict.fromkeys(cells_by_region, (LOWEST_READING, HIGHEST_READING))
    )
    asides = [aside for frame in frames for aside in frame.above]
    headings = {name: name for name in cells}
    unit = unit_in(paths[0], settings, headings, numbers, asides)
    pixels = {name: checked_celsius(name, numbers[name].values, unit, location_of) for name in settings.regions}
    values = np.stack(
        [
            STATISTICS[region.statistic](pixels[name].reshape(len(frames), -1), axis=1)
            for name, region in settings.regions.items()
        ],
        axis=1,
    )
    line = settings.time.line or ""
    stamps = [stamp_of(frame, line) for frame in frames] if line else []
    plain = None
    if stamps and looks_plain(stamps[0]):
        plain = read_numbers({line: stamps}, settings, lambda _, row: frame_location(row), {})[0][line]
    clock = row_times(len(frames), stamps, plain, line, settings, frame_location)
    remarks += [str(convention), f"temperatures in {unit}", clock.description, *missing_remarks(headings, numbers)]
    remarks += odd_number_remarks(cells_by_region, row_cells, convention, location_of) + heat_remarks(
        pixels, unit, location_of
    )
    return CameraFile(clock, values, frame_location, remarks + emissivity_remarks(asides))


def split_line(line: str, delimiter: str) -> list[str]:
    """Cells of a line; quotes protect a delimiter in a cell."""
    return cells_of(line, delimiter) if '"' in line else line.split(delimiter)


def delimiter_of(path: Path, lines: Sequence[str], settings: ThermalCsvSettings) -> str:
    """Delimiter that the file or the settings state, else the only one that gives rows of equally many numbers.

    Raises
    ------
    InputError : no delimiter or several fit.
    """
    declared = SEP_LINE.match(lines[0])
    if settings.delimiter or declared:
        return settings.delimiter or (declared[1] if declared else "")
    first = settings.skip_lines
    sample = [line for line in lines[first : first + 200] if line.strip() and not is_text_line(line, settings)][:50]
    sample = sample[1:] or sample  # the first line may be the size of the frame
    fitting = []
    for mark in DELIMITERS:
        rows = [strip_cells(split_line(line, mark)) for line in sample]
        plain = rows and all(looks_plain(cell) or not any(c.isdigit() for c in cell) for cell in rows[-1])
        if plain and len({len(row) for row in rows}) == 1 and len(rows[0]) > 1:
            fitting.append(mark)
    if len(fitting) != 1:
        names = " and ".join(DELIMITER_NAMES.get(mark, repr(mark)) for mark in fitting) or "no mark"
        hint = "" if fitting else f", where its first lines are rows; {PIXELS_HINT}"
        raise InputError(f"{path}: {names} cuts its lines into rows of numbers; delimiter decides{hint}")
    return fitting[0]


def is_text_line(line: str, settings: ThermalCsvSettings) -> bool:
    """Return whether a line begins with a word and is no row of pixels; a missing pixel may be letters too."""
    first = next((plain for cell in CELL_ENDS.split(line) if (plain := cell.strip("\"' ["))), "")
    return LETTER.match(first) is not None and first not in settings.missing


def is_labelled_row(cells: Sequence[str], settings: ThermalCsvSettings) -> bool:
    """Return whether a word precedes pixels in a row: `Frame 1;25.0;25.1`."""
    missing = frozenset(settings.missing)
    pixels = [split_cell(cell, missing) for cell in cells[1:]]
    return None not in pixels and sum(bool(cell and cell.number) for cell in pixels) > 1


def frames_in(path: Path, lines: Sequence[str], delimiter: str, settings: ThermalCsvSettings) -> list[PixelFrame]:
    """Split the lines of a file into frames; the last frame has no row if the file ends with text or a blank line."""
    frames = [PixelFrame(path, 1, delimiter)]
    for number, line in enumerate(lines, start=1):
        if SEP_LINE.match(line):
            continue
        cells = strip_cells(split_line(line, delimiter))
        is_text = bool(cells) and is_text_line(line, settings)
        labelled = is_text and is_labelled_row(cells, settings)
        begins = labelled and settings.index_column is True and FRAME_LABEL.fullmatch(cells[0]) is not None
        if not cells or number <= settings.skip_lines or is_text or begins:
            if frames[-1].rows:
                frames.append(PixelFrame(path, number + 1, delimiter))
            if cells and not begins:
                note_named_value(frames[-1], number, cells, delimiter)
                frames[-1].label = (number, len(cells)) if labelled else (0, 0)
            if not begins:
                continue
        if '"' in line:
            next(rows_of(path, [line], delimiter, strict=True, lines_before=number - 1))
        if not frames[-1].rows:
            frames[-1].line = number
        frames[-1].rows.append(line)
    return frames


def text_line_remarks(frames: Sequence[PixelFrame], unfinished: PixelFrame) -> list[str]:
    """Remarks on lines of text that one frame has above it and the other frames have not."""
    remarks = []
    if frames and not unfinished.rows and unfinished.above:
        remarks.append(
            f"{unfinished.path.name}: line {unfinished.above[0].line}: text below the last frame:"
            f" {unfinished.above[0].name!r}"
        )
    usual = [aside.name for aside in frames[1].above] if len(frames) > 1 else []
    for number, frame in enumerate(frames):
        names = [aside.name for aside in frame.above]
        if (names if number else names[len(names) - len(usual) :]) != usual:
            remarks.append(f"{frame.path.name}: the lines above line {frame.line} are not those of the other frames")
            break
    return remarks


def store_stated_size(frames: Sequence[PixelFrame], settings: ThermalCsvSettings) -> None:
    """Store the size of the frames that a file states by names, in a line above, or by numbers of rows and columns."""
    if not frames:
        return
    first = frames[0]
    named = {aside.name.lower(): aside.value for aside in first.above}
    rows, columns = (
        next((int(named[name]) for name in names if named.get(name, "").isdecimal()), None) for names in SIZE_NAMES
    )
    if len(first.rows) > 1:
        size = strip_cells(first.cells(0))
        counted = len(first.rows) - 1, len(strip_cells(first.cells(1)))
        if size == [str(counted[1]), str(counted[0])]:
            first.rows.pop(0)
            first.line += 1
            rows, columns = counted
    if settings.index_column is True:
        columns = columns or first.label[1] - 1 if first.label[1] else columns  # by the row of column numbers
        rows = rows or len(first.rows) if first.cells(0)[0].strip("\"' ") == "0" else rows  # a lost row leaves a gap
    for frame in frames:
        frame.size = rows, columns


def note_named_value(frame: PixelFrame, line: int, cells: Sequence[str], delimiter: str) -> None:
    """Store the named value of a line between frames: `Time = ...`, `Emissivity: 0.95`, `width;640`."""
    filled = [cell for cell in cells if cell]
    match = NAME_VALUE.fullmatch(filled[0])
    name, value = (match[1], match[2]) if match else (filled[0], "")
    value = delimiter.join([value, *cells[1:]]) if value else " ".join(filled[1:2])  # a stamp may have a comma
    frame.above.append(Aside(line, name.strip("\"'"), value))


def frames_of_one_size(
    frames: list[PixelFrame], settings: ThermalCsvSettings
) -> tuple[list[PixelFrame], int, list[str]]:
    """Check that frames have one size; drop an incomplete last frame. Returns frames, width and remarks.

    Raises
    ------
    InputError : no frame, or a frame whose size differs from the stated one or from that of the others.
    """
    if not frames:
        raise InputError("no frame of numbers was found")
    if settings.frame_size is not None:
        frames = [part for frame in frames for part in parts_of(frame, settings.frame_size[0])]
    index = int(settings.index_column is True)
    sizes = [{len(strip_cells(frame.cells(row))) - index for row in range(len(frame.rows))} for frame in frames]
    stated = settings.frame_size or frames[0].size
    height, width = stated[0] or len(frames[0].rows), stated[1] or max(sizes[0])
    remarks = []
    last = frames[-1]
    if len(frames) > 1 and (len(last.rows) < height or min(sizes[-1]) < width):
        remarks.append(f"the last frame, from line {last.line} on, is cut short: left out")
        frames, sizes = frames[:-1], sizes[:-1]
    for frame, widths in zip(frames, sizes, strict=True):
        if widths != {width} or len(frame.rows) != height:
            shape = f"{len(frame.rows)} rows of {' or '.join(map(str, sorted(widths)))} cells"
            expected = f"{height} of {width} were expected; {PIXELS_HINT}"
            raise InputError(f"{frame.path}: line {frame.line}: a frame of {shape}; {expected}")
    if None in stated:
        remarks.append("nothing states the size of the frames, by which lost rows or cells are seen; frame_size does")
    return frames, width, remarks


def parts_of(frame: PixelFrame, height: int) -> list[PixelFrame]:
    """Split a frame into frames of a height; return it unsplit if its rows are not a multiple of the height."""
    if len(frame.rows) % height:
        return [frame]
    starts = range(0, len(frame.rows), height)
    return [
        replace(frame, line=frame.line + first_row, rows=frame.rows[first_row : first_row + height])
        for first_row in starts
    ]


def check_first_cells(frames: Sequence[PixelFrame], settings: ThermalCsvSettings) -> None:
    """Check that the settings say whether the cells before and above the pixels are pixels.

    Raises
    ------
    InputError : an axis, numbers of rows or columns, or a label of a row, which no setting declares; or row numbers
        that have a gap.
    """
    first = frames[0]
    index = int(settings.index_column is True)
    above = strip_cells(first.cells(0))[index:]
    left_column = [cell for row in range(len(first.rows)) for cell in first.cells(row)[index : index + 1]]
    is_stated = settings.frame_size is not None and None not in settings.frame_size
    if len(above) >= LEAST_AXIS_LENGTH and counts_by_one(above):
        raise InputError(f"{first.path}: line {first.line}: counts its columns, which are no pixels; {PIXELS_HINT}")
    if is_axis(above, left_column) and not is_stated:
        reason = "rises or falls evenly, as the places of columns do, and the rows below it do not go on so"
        raise InputError(f"{first.path}: line {first.line}: {reason}; {PIXELS_HINT}")
    for frame in frames:
        cells = [frame.cells(row)[0].strip("\"' ") for row in range(len(frame.rows))]
        filled = [cell for cell in cells if cell and not FRAME_LABEL.fullmatch(cell)]
        if settings.index_column is True and filled and (row := row_out_of_order(cells)) is not None:
            raise InputError(f"{frame.path}: line {frame.line + row}: {cells[row]!r} is not the next number of a row")
        if settings.index_column is not None:
            continue
        if frame.label[1] == len(strip_cells(frame.cells(0))):
            reason = f"line {frame.label[0]}: a word and as many cells as a row has"
        elif not any(cells):
            reason = f"line {frame.line}: the first cell of every row is empty"
        elif len(cells) >= LEAST_AXIS_LENGTH and counts_by_one(cells):
            reason = f"line {frame.line}: the first cells count the rows"
        elif is_axis(cells, strip_cells(frame.cells(0))):
            reason = f"line {frame.line}: the first cells rise or fall evenly, as the places of rows do"
        else:
            continue
        raise InputError(f"{frame.path}: {reason}; index_column says whether first cells are pixels")


def row_out_of_order(cells: Sequence[str]) -> int | None:
    """Index of the first row whose number or coordinate does not continue those above; None if all do."""
    if counts_by_one(cells) or (len(cells) >= LEAST_AXIS_LENGTH and is_even(cells)):
        return None
    continues = counts_by_one if all(cell.isdecimal() for cell in cells) else is_even
    return next(row for row in range(len(cells)) if not continues(cells[: row + 1]))


def counts_by_one(cells: Sequence[str]) -> bool:
    """Return whether cells are whole numbers, each larger by one than the one before."""
    if not all(cell.strip("\"' ").isdecimal() for cell in cells):
        return False
    numbers = [int(cell.strip("\"' ")) for cell in cells]
    return all(after == before + 1 for before, after in pairwise(numbers))


def is_axis(cells: Sequence[str], across: Sequence[str]) -> bool:
    """Return whether cells, after a corner that may be empty, rise or fall evenly, and those across from them do not.

    Pixels that rise evenly in both directions are a slope.
    """
    axis_cells = cells[1:] if cells and not cells[0].strip("\"' ") else cells
    return min(len(axis_cells), len(across)) >= LEAST_AXIS_LENGTH and is_even(axis_cells) and not is_even(across)


def is_even(cells: Sequence[str]) -> bool:
    """Return whether cells are numbers with one constant step between them, up to rounding."""
    texts = [cell.strip("\"' ") for cell in cells]
    if not all(NUMBER.fullmatch(text) for text in texts):
        return False
    numbers = [Decimal(text.replace(",", ".")) for text in texts]
    if len(numbers) < 2:
        return True
    step = (numbers[-1] - numbers[0]) / (len(numbers) - 1)
    deviation = max(abs(number - numbers[0] - step * index) for index, number in enumerate(numbers))
    digit = max(Decimal(1).scaleb(int(number.as_tuple().exponent)) for number in numbers)
    return step != 0 and (
        deviation < digit / 1000 or (deviation <= digit < 1 and digit <= Decimal(MOST_ROUNDING_SHARE) * abs(step))
    )


def refuse_halves(frames: Sequence[PixelFrame], settings: ThermalCsvSettings) -> None:
    """Raise InputError if every two cells of comma-separated rows may be one number with a decimal comma."""
    if settings.decimal is not None or not frames or frames[0].delimiter != ",":
        return
    first = frames[0]
    index = int(settings.index_column is True)
    rows = [strip_cells(first.cells(row))[index:] for row in range(len(first.rows))]
    lengths_of_second_cells = {len(cell) for row in rows for cell in row[1::2]}
    are_integers = all(cell.lstrip("+-").isdecimal() for row in rows for cell in row)
    if are_integers and len(lengths_of_second_cells) == 1 and all(len(row) % 2 == 0 for row in rows):
        both = ",".join(rows[0][:2])
        raise InputError(f"{first.path}: line {first.line}: {both!r} is one number or two; decimal decides")


def region_cells(
    frames: Sequence[PixelFrame], width: int, settings: ThermalCsvSettings
) -> tuple[dict[str, list[list[str]]], set[str]]:
    """Cells of each region, by frame, and all cells of the regions' rows.

    Raises
    ------
    InputError : a region lies outside the frames.
    """
    height = len(frames[0].rows)
    index = int(settings.index_column is True)
    spans: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {}
    for name, region in settings.regions.items():
        spans[name] = span_of(region)
        if spans[name][0][1] >= height or spans[name][1][1] >= width:
            raise InputError(f"{frames[0].path}: region {name} goes past the frames of {height} rows, {width} columns")
    needed = sorted({row for rows, _ in spans.values() for row in range(rows[0], rows[1] + 1)})
    cells: dict[str, list[list[str]]] = {name: [] for name in spans}
    cells_of_rows: set[str] = set()
    for frame in frames:
        split = {row: frame.cells(row)[index:] for row in needed}
        for row_cells in split.values():
            cells_of_rows.update(row_cells)
        for name, (rows, columns) in spans.items():
            rows_of_region = [split[row][columns[0] : columns[1] + 1] for row in range(rows[0], rows[1] + 1)]
            cells[name].append([cell for row_cells in rows_of_region for cell in row_cells])
    return cells, cells_of_rows


def span_of(region: CameraRegion) -> tuple[tuple[int, int], tuple[int, int]]:
    """First and last row, first and last column."""
    assert region.rows is not None
    assert region.columns is not None
    return region.rows, region.columns


def stamp_of(frame: PixelFrame, name: str) -> str:
    """Value above a frame that has this name and holds the frame's time.

    Raises
    ------
    InputError : there is no value of that name, or several.
    """
    values = [aside.value for aside in frame.above if aside.name == name]
    if len(values) != 1:
        names = ", ".join(repr(aside.name) for aside in frame.above) or "nothing"
        raise InputError(f"{frame.path}: the frame from line {frame.line} on has {names} above it, not one {name!r}")
    return values[0]
