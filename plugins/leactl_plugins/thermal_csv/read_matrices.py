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
# by which a file states its numbers of rows and of columns, in lower case
SIZE_NAMES = (("height", "imageheight"), ("width", "imagewidth"))
LEAST_AXIS_CELLS = 3  # fewer cells that rise or fall evenly are not taken for an axis
MOST_ROUNDING_OVER_STEP = 1 / 3  # largest rounding of the numbers of an axis, over its step
NUMBER_CELL = re.compile(r"[+-]?[0-9]+([.,][0-9]+)?")
PIXELS_HINT = "skip_lines, index_column and frame_size tell which cells are pixels"


@dataclass
class PixelFrame:
    """Unparsed lines of one frame, the number of its first line, and the named values above it."""

    path: Path
    line: int
    delimiter: str
    rows: list[str] = field(default_factory=list)
    above: list[Aside] = field(default_factory=list)
    label: tuple[int, int] = (0, 0)  # number of a labelled line above, which looks like a row, and its cells
    size: tuple[int | None, int | None] = (None, None)  # rows and columns, as the file states them

    def cells(self, row: int) -> list[str]:
        """Return the cells of one row, including its number if it has one."""
        return split_line(self.rows[row], self.delimiter)


def read_matrices(paths: Sequence[Path], settings: ThermalCsvSettings) -> CameraFile:
    """Read the frames of one file or of several, in the order given.

    Raises
    ------
    InputError : there are no frames, frames of different sizes, regions outside them, or ambiguous stamps or numbers.
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
        *file_frames, trailing_frame = frames_in(path, lines, delimiter, settings)
        if trailing_frame.rows:
            file_frames.append(trailing_frame)
        store_stated_size(file_frames, settings)
        remarks += text_line_remarks(file_frames, trailing_frame)
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

    def frame_location(frame_index: int) -> str:
        return f"{frames[frame_index].path}: the frame from line {frames[frame_index].line} on"

    frame_cells_by_region, cells_of_rows = region_cells(frames, width, settings)
    cells_by_region = {
        name: [cell for frame in frames_of_region for cell in frame]
        for name, frames_of_region in frame_cells_by_region.items()
    }
    sizes = {name: len(frames_of_region[0]) for name, frames_of_region in frame_cells_by_region.items()}

    def location_of(name: str, cell: int) -> str:
        return f"{frame_location(cell // sizes[name])}, region {name}"

    numbers_by_region, number_format = read_numbers(
        cells_by_region, settings, location_of, dict.fromkeys(cells_by_region, (LOWEST_READING, HIGHEST_READING))
    )
    asides = [aside for frame in frames for aside in frame.above]
    headings = {name: name for name in frame_cells_by_region}
    unit = unit_in(paths[0], settings, headings, numbers_by_region, asides)
    pixels = {
        name: checked_celsius(name, numbers_by_region[name].values, unit, location_of) for name in settings.regions
    }
    values = np.stack(
        [
            STATISTICS[region.statistic](pixels[name].reshape(len(frames), -1), axis=1)
            for name, region in settings.regions.items()
        ],
        axis=1,
    )
    stamp_name = settings.time.line or ""
    stamps = [stamp_of(frame, stamp_name) for frame in frames] if stamp_name else []
    plain_numbers = None
    if stamps and looks_plain(stamps[0]):
        plain_numbers = read_numbers(
            {stamp_name: stamps}, settings, lambda _, frame_index: frame_location(frame_index), {}
        )[0][stamp_name]
    clock = row_times(len(frames), stamps, plain_numbers, stamp_name, settings, frame_location)
    remarks += [
        str(number_format),
        f"temperatures in {unit}",
        clock.description,
        *missing_remarks(headings, numbers_by_region),
    ]
    remarks += odd_number_remarks(cells_by_region, cells_of_rows, number_format, location_of) + heat_remarks(
        pixels, unit, location_of
    )
    return CameraFile(clock, values, frame_location, remarks + emissivity_remarks(asides))


def split_line(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; quotes protect a delimiter in a cell."""
    return cells_of(line, delimiter) if '"' in line else line.split(delimiter)


def delimiter_of(path: Path, lines: Sequence[str], settings: ThermalCsvSettings) -> str:
    """Return the delimiter that file or settings state, else the only one that gives rows of equally many numbers.

    Raises
    ------
    InputError : none is stated, and no delimiter or several fit.
    """
    sep_line = SEP_LINE.match(lines[0])
    if settings.delimiter or sep_line:
        return settings.delimiter or (sep_line[1] if sep_line else "")
    first_line = settings.skip_lines
    sample = [
        line for line in lines[first_line : first_line + 200] if line.strip() and not is_text_line(line, settings)
    ][:50]
    sample = sample[1:] or sample  # the first line may be the size of the frame
    fitting_delimiters = []
    for delimiter in DELIMITERS:
        rows = [strip_cells(split_line(line, delimiter)) for line in sample]
        are_numbers = rows and all(looks_plain(cell) or not any(c.isdigit() for c in cell) for cell in rows[-1])
        if are_numbers and len({len(row) for row in rows}) == 1 and len(rows[0]) > 1:
            fitting_delimiters.append(delimiter)
    if len(fitting_delimiters) != 1:
        names = (
            " and ".join(DELIMITER_NAMES.get(delimiter, repr(delimiter)) for delimiter in fitting_delimiters)
            or "no mark"
        )
        hint = "" if fitting_delimiters else f", where its first lines are rows; {PIXELS_HINT}"
        raise InputError(f"{path}: {names} cuts its lines into rows of numbers; delimiter decides{hint}")
    return fitting_delimiters[0]


def is_text_line(line: str, settings: ThermalCsvSettings) -> bool:
    """Return whether a line begins with a word, unless this marks a missing pixel."""
    first_word = next((word for cell in CELL_ENDS.split(line) if (word := cell.strip("\"' ["))), "")
    return LETTER.match(first_word) is not None and first_word not in settings.missing


def is_labelled_row(cells: Sequence[str], settings: ThermalCsvSettings) -> bool:
    """Return whether a word precedes pixels in a row: `Frame 1;25.0;25.1`."""
    missing_marks = frozenset(settings.missing)
    pixels = [split_cell(cell, missing_marks) for cell in cells[1:]]
    return None not in pixels and sum(bool(cell and cell.number) for cell in pixels) > 1


def frames_in(path: Path, lines: Sequence[str], delimiter: str, settings: ThermalCsvSettings) -> list[PixelFrame]:
    """Split the lines of a file into frames; the last one has no row if the file ends with text or a blank line."""
    frames = [PixelFrame(path, 1, delimiter)]
    for line_number, line in enumerate(lines, start=1):
        if SEP_LINE.match(line):
            continue
        cells = strip_cells(split_line(line, delimiter))
        is_text = bool(cells) and is_text_line(line, settings)
        is_labelled = is_text and is_labelled_row(cells, settings)
        begins_frame = is_labelled and settings.index_column is True and FRAME_LABEL.fullmatch(cells[0]) is not None
        if not cells or line_number <= settings.skip_lines or is_text or begins_frame:
            if frames[-1].rows:
                frames.append(PixelFrame(path, line_number + 1, delimiter))
            if cells and not begins_frame:
                note_named_value(frames[-1], line_number, cells, delimiter)
                frames[-1].label = (line_number, len(cells)) if is_labelled else (0, 0)
            if not begins_frame:
                continue
        if '"' in line:
            next(rows_of(path, [line], delimiter, strict=True, lines_before=line_number - 1))
        if not frames[-1].rows:
            frames[-1].line = line_number
        frames[-1].rows.append(line)
    return frames


def text_line_remarks(frames: Sequence[PixelFrame], trailing_frame: PixelFrame) -> list[str]:
    """Return remarks on text below the last frame, and on the first frame with other text above it than usual."""
    remarks = []
    if frames and not trailing_frame.rows and trailing_frame.above:
        remarks.append(
            f"{trailing_frame.path.name}: line {trailing_frame.above[0].line}: text below the last frame:"
            f" {trailing_frame.above[0].name!r}"
        )
    usual_names = [aside.name for aside in frames[1].above] if len(frames) > 1 else []
    for number, frame in enumerate(frames):
        names = [aside.name for aside in frame.above]
        if (names if number else names[len(names) - len(usual_names) :]) != usual_names:
            remarks.append(f"{frame.path.name}: the lines above line {frame.line} are not those of the other frames")
            break
    return remarks


def store_stated_size(frames: Sequence[PixelFrame], settings: ThermalCsvSettings) -> None:
    """Store in each frame the size that a file states by names, in a line above, or by numbers of rows and columns."""
    if not frames:
        return
    first_frame = frames[0]
    values_by_name = {aside.name.lower(): aside.value for aside in first_frame.above}
    rows, columns = (
        next((int(values_by_name[name]) for name in names if values_by_name.get(name, "").isdecimal()), None)
        for names in SIZE_NAMES
    )
    if len(first_frame.rows) > 1:
        size_cells = strip_cells(first_frame.cells(0))
        counted_rows, counted_columns = len(first_frame.rows) - 1, len(strip_cells(first_frame.cells(1)))
        if size_cells == [str(counted_columns), str(counted_rows)]:
            first_frame.rows.pop(0)
            first_frame.line += 1
            rows, columns = counted_rows, counted_columns
    if settings.index_column is True:
        # the labelled line holds column numbers
        columns = columns or first_frame.label[1] - 1 if first_frame.label[1] else columns
        # row numbers count from 0, so that a lost row leaves a gap
        rows = rows or len(first_frame.rows) if first_frame.cells(0)[0].strip("\"' ") == "0" else rows
    for frame in frames:
        frame.size = rows, columns


def note_named_value(frame: PixelFrame, line: int, cells: Sequence[str], delimiter: str) -> None:
    """Store the named value of a line between frames: `Time = ...`, `Emissivity: 0.95`, `width;640`."""
    filled_cells = [cell for cell in cells if cell]
    match = NAME_VALUE.fullmatch(filled_cells[0])
    name, value = (match[1], match[2]) if match else (filled_cells[0], "")
    value = delimiter.join([value, *cells[1:]]) if value else " ".join(filled_cells[1:2])  # a stamp may have a comma
    frame.above.append(Aside(line, name.strip("\"'"), value))


def frames_of_one_size(
    frames: list[PixelFrame], settings: ThermalCsvSettings
) -> tuple[list[PixelFrame], int, list[str]]:
    """Check that frames have one size; drop an incomplete last frame; return frames, width and remarks.

    Raises
    ------
    InputError : there is no frame, or its size differs from the stated one or from that of the others.
    """
    if not frames:
        raise InputError("no frame of numbers was found")
    if settings.frame_size is not None:
        frames = [part for frame in frames for part in frames_of_height(frame, settings.frame_size[0])]
    index_cells = int(settings.index_column is True)
    widths_by_frame = [
        {len(strip_cells(frame.cells(row))) - index_cells for row in range(len(frame.rows))} for frame in frames
    ]
    stated_height, stated_width = settings.frame_size or frames[0].size
    height, width = stated_height or len(frames[0].rows), stated_width or max(widths_by_frame[0])
    remarks = []
    last_frame = frames[-1]
    if len(frames) > 1 and (len(last_frame.rows) < height or min(widths_by_frame[-1]) < width):
        remarks.append(f"the last frame, from line {last_frame.line} on, is cut short: left out")
        frames, widths_by_frame = frames[:-1], widths_by_frame[:-1]
    for frame, widths in zip(frames, widths_by_frame, strict=True):
        if widths != {width} or len(frame.rows) != height:
            shape = f"{len(frame.rows)} rows of {' or '.join(map(str, sorted(widths)))} cells"
            expected = f"{height} of {width} were expected; {PIXELS_HINT}"
            raise InputError(f"{frame.path}: line {frame.line}: a frame of {shape}; {expected}")
    if None in (stated_height, stated_width):
        remarks.append("nothing states the size of the frames, by which lost rows or cells are seen; frame_size does")
    return frames, width, remarks


def frames_of_height(frame: PixelFrame, height: int) -> list[PixelFrame]:
    """Split a frame into frames of a height; return it unsplit if its rows are not a multiple of the height."""
    if len(frame.rows) % height:
        return [frame]
    first_rows = range(0, len(frame.rows), height)
    return [
        replace(frame, line=frame.line + first_row, rows=frame.rows[first_row : first_row + height])
        for first_row in first_rows
    ]


def check_first_cells(frames: Sequence[PixelFrame], settings: ThermalCsvSettings) -> None:
    """Check that the settings say whether the cells before and above the pixels are pixels.

    Raises
    ------
    InputError : the frames have an axis, numbers of rows or columns, or labels of rows, which no setting declares; or
        the row numbers have a gap.
    """
    first_frame = frames[0]
    index_cells = int(settings.index_column is True)
    top_row = strip_cells(first_frame.cells(0))[index_cells:]
    left_column = [
        cell for row in range(len(first_frame.rows)) for cell in first_frame.cells(row)[index_cells : index_cells + 1]
    ]
    is_size_stated = settings.frame_size is not None and None not in settings.frame_size
    if len(top_row) >= LEAST_AXIS_CELLS and counts_by_one(top_row):
        raise InputError(
            f"{first_frame.path}: line {first_frame.line}: counts its columns, which are no pixels; {PIXELS_HINT}"
        )
    if is_axis(top_row, left_column) and not is_size_stated:
        reason = "rises or falls evenly, as the places of columns do, and the rows below it do not go on so"
        raise InputError(f"{first_frame.path}: line {first_frame.line}: {reason}; {PIXELS_HINT}")
    for frame in frames:
        first_cells = [frame.cells(row)[0].strip("\"' ") for row in range(len(frame.rows))]
        numbered_cells = [cell for cell in first_cells if cell and not FRAME_LABEL.fullmatch(cell)]
        if settings.index_column is True and numbered_cells and (row := row_out_of_order(first_cells)) is not None:
            raise InputError(
                f"{frame.path}: line {frame.line + row}: {first_cells[row]!r} is not the next number of a row"
            )
        if settings.index_column is not None:
            continue
        if frame.label[1] == len(strip_cells(frame.cells(0))):
            reason = f"line {frame.label[0]}: a word and as many cells as a row has"
        elif not any(first_cells):
            reason = f"line {frame.line}: the first cell of every row is empty"
        elif len(first_cells) >= LEAST_AXIS_CELLS and counts_by_one(first_cells):
            reason = f"line {frame.line}: the first cells count the rows"
        elif is_axis(first_cells, strip_cells(frame.cells(0))):
            reason = f"line {frame.line}: the first cells rise or fall evenly, as the places of rows do"
        else:
            continue
        raise InputError(f"{frame.path}: {reason}; index_column says whether first cells are pixels")


def row_out_of_order(cells: Sequence[str]) -> int | None:
    """Return the index of the first row whose number or coordinate does not continue those above; None if all do."""
    if counts_by_one(cells) or (len(cells) >= LEAST_AXIS_CELLS and is_evenly_spaced(cells)):
        return None
    continues = counts_by_one if all(cell.isdecimal() for cell in cells) else is_evenly_spaced
    return next(row for row in range(len(cells)) if not continues(cells[: row + 1]))


def counts_by_one(cells: Sequence[str]) -> bool:
    """Return whether cells are whole numbers, each larger by one than its predecessor."""
    if not all(cell.strip("\"' ").isdecimal() for cell in cells):
        return False
    numbers = [int(cell.strip("\"' ")) for cell in cells]
    return all(after == before + 1 for before, after in pairwise(numbers))


def is_axis(cells: Sequence[str], crossing_cells: Sequence[str]) -> bool:
    """Return whether cells rise or fall evenly after a corner that may be empty, and the crossing cells do not.

    If both rise evenly, they are pixels on a slope.
    """
    axis_cells = cells[1:] if cells and not cells[0].strip("\"' ") else cells
    return (
        min(len(axis_cells), len(crossing_cells)) >= LEAST_AXIS_CELLS
        and is_evenly_spaced(axis_cells)
        and not is_evenly_spaced(crossing_cells)
    )


def is_evenly_spaced(cells: Sequence[str]) -> bool:
    """Return whether cells are numbers with one constant step between them, up to rounding."""
    texts = [cell.strip("\"' ") for cell in cells]
    if not all(NUMBER_CELL.fullmatch(text) for text in texts):
        return False
    numbers = [Decimal(text.replace(",", ".")) for text in texts]
    if len(numbers) < 2:
        return True
    step = (numbers[-1] - numbers[0]) / (len(numbers) - 1)
    deviation = max(abs(number - numbers[0] - step * index) for index, number in enumerate(numbers))
    last_place = max(Decimal(1).scaleb(int(number.as_tuple().exponent)) for number in numbers)
    return step != 0 and (
        deviation < last_place / 1000
        or (deviation <= last_place < 1 and last_place <= Decimal(MOST_ROUNDING_OVER_STEP) * abs(step))
    )


def refuse_halves(frames: Sequence[PixelFrame], settings: ThermalCsvSettings) -> None:
    """Raise InputError if each pair of cells of comma-separated rows may be one number with a decimal comma."""
    if settings.decimal is not None or not frames or frames[0].delimiter != ",":
        return
    first_frame = frames[0]
    index_cells = int(settings.index_column is True)
    rows = [strip_cells(first_frame.cells(row))[index_cells:] for row in range(len(first_frame.rows))]
    lengths_of_second_cells = {len(cell) for row in rows for cell in row[1::2]}
    are_integers = all(cell.lstrip("+-").isdecimal() for row in rows for cell in row)
    if are_integers and len(lengths_of_second_cells) == 1 and all(len(row) % 2 == 0 for row in rows):
        two_cells = ",".join(rows[0][:2])
        raise InputError(
            f"{first_frame.path}: line {first_frame.line}: {two_cells!r} is one number or two; decimal decides"
        )


def region_cells(
    frames: Sequence[PixelFrame], width: int, settings: ThermalCsvSettings
) -> tuple[dict[str, list[list[str]]], set[str]]:
    """Return the cells of each region, by frame, and all cells of the regions' rows.

    Raises
    ------
    InputError : a region lies outside the frames.
    """
    height = len(frames[0].rows)
    index_cells = int(settings.index_column is True)
    spans: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {}
    for name, region in settings.regions.items():
        spans[name] = span_of(region)
        (_, last_row), (_, last_column) = spans[name]
        if last_row >= height or last_column >= width:
            raise InputError(f"{frames[0].path}: region {name} goes past the frames of {height} rows, {width} columns")
    needed_rows = sorted({row for (first_row, last_row), _ in spans.values() for row in range(first_row, last_row + 1)})
    cells_by_region: dict[str, list[list[str]]] = {name: [] for name in spans}
    cells_of_rows: set[str] = set()
    for frame in frames:
        cells_by_row = {row: frame.cells(row)[index_cells:] for row in needed_rows}
        for row_cells in cells_by_row.values():
            cells_of_rows.update(row_cells)
        for name, ((first_row, last_row), (first_column, last_column)) in spans.items():
            rows_of_region = [
                cells_by_row[row][first_column : last_column + 1] for row in range(first_row, last_row + 1)
            ]
            cells_by_region[name].append([cell for row_cells in rows_of_region for cell in row_cells])
    return cells_by_region, cells_of_rows


def span_of(region: CameraRegion) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return first and last row, and first and last column, of a region."""
    assert region.rows is not None
    assert region.columns is not None
    return region.rows, region.columns


def stamp_of(frame: PixelFrame, name: str) -> str:
    """Return the value of this name above a frame, which is the frame's time.

    Raises
    ------
    InputError : there is no value of that name, or several.
    """
    values = [aside.value for aside in frame.above if aside.name == name]
    if len(values) != 1:
        names = ", ".join(repr(aside.name) for aside in frame.above) or "nothing"
        raise InputError(f"{frame.path}: the frame from line {frame.line} on has {names} above it, not one {name!r}")
    return values[0]
