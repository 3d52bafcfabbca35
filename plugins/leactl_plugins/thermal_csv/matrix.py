"""Read frames of pixels: one line per row, frames separated by blank lines or by lines with their time."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from leactl.driver.batch import refuse_text_order
from leactl.errors import InputError
from leactl.tables.number_format import read_numbers
from leactl.tables.text_table import DELIMITER_NAMES, DELIMITERS, SEP_LINE, Aside, read_text, strip_cells
from leactl_plugins.thermal_csv.series import (
    COLDEST,
    HOTTEST,
    Array,
    CameraFile,
    emissivity_remarks,
    missing_remarks,
    row_times,
    to_celsius,
    unit_in,
)
from leactl_plugins.thermal_csv.settings import CameraRegion, ThermalCsvSettings
from leactl_plugins.thermal_csv.stamps import looks_plain

LETTER = re.compile(r"[^\W\d_]")
CELL_ENDS = re.compile(f"[{''.join(DELIMITERS)}]")
STATISTICS: dict[str, Callable[..., Array]] = {"mean": np.mean, "max": np.max, "min": np.min}
NAME_VALUE = re.compile(r"\s*([^:=]*?)\s*[:=]\s*(.*)")


@dataclass
class PixelFrame:
    """Unparsed lines of one frame, its first line, and the named values above it."""

    path: Path
    line: int
    rows: list[str] = field(default_factory=list)
    above: list[Aside] = field(default_factory=list)


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
        remarks.append(f"{encoding}, {DELIMITER_NAMES.get(delimiter, repr(delimiter))} between cells")
        frames += frames_in(path, lines, delimiter, settings)
        if not text.endswith(("\n", "\r")):
            remarks.append(f"{path.name} has no end of its last line: the last pixel may be cut")
    remarks = list(dict.fromkeys(remarks))
    if settings.time.line is None:
        refuse_text_order(paths)
    frames, width, left_out = frames_of_one_size(frames, delimiter)
    remarks += [f"{len(frames)} frames of {len(frames[0].rows)} rows and {width} columns", *left_out]

    def where(row: int) -> str:
        return f"{frames[row].path}: the frame from line {frames[row].line} on"

    cells = region_cells(frames, delimiter, width, settings)
    cells_by_region = {name: [cell for frame in of for cell in frame] for name, of in cells.items()}
    sizes = {name: len(of[0]) for name, of in cells.items()}

    def place(name: str, at: int) -> str:
        return f"{where(at // sizes[name])}, region {name}"

    numbers, convention = read_numbers(
        cells_by_region, settings, place, dict.fromkeys(cells_by_region, (COLDEST, HOTTEST))
    )
    asides = [aside for frame in frames for aside in frame.above]
    headings = {name: name for name in cells}
    unit = unit_in(paths[0], settings, headings, numbers, asides)
    values = np.stack(
        [
            STATISTICS[region.statistic](to_celsius(numbers[name].values, unit).reshape(len(frames), -1), axis=1)
            for name, region in settings.regions.items()
        ],
        axis=1,
    )
    line = settings.time.line or ""
    stamps = [stamp_of(frame, line) for frame in frames] if line else []
    plain = None
    if stamps and looks_plain(stamps[0]):
        plain = read_numbers({line: stamps}, settings, lambda _, row: where(row), {})[0][line]
    clock = row_times(len(frames), stamps, plain, line, settings, where)
    remarks += [str(convention), f"temperatures in {unit}", clock.description, *missing_remarks(headings, numbers)]
    return CameraFile(clock, values, where, remarks + emissivity_remarks(asides))


def delimiter_of(path: Path, lines: Sequence[str], settings: ThermalCsvSettings) -> str:
    """The delimiter: as stated, or the only one that splits the first lines into equally many numbers."""
    declared = SEP_LINE.match(lines[0])
    if settings.delimiter or declared:
        return settings.delimiter or (declared[1] if declared else "")
    sample = [line for line in lines[:200] if line.strip() and not is_text_line(line, settings)][:50]
    fitting = [
        mark
        for mark in DELIMITERS
        if sample
        and len({len(strip_cells(line.split(mark))) for line in sample}) == 1
        and len(strip_cells(sample[0].split(mark))) > 1
        and all(looks_plain(cell) or not any(c.isdigit() for c in cell) for cell in sample[0].split(mark))
    ]
    if len(fitting) != 1:
        names = " and ".join(DELIMITER_NAMES.get(mark, repr(mark)) for mark in fitting) or "no mark"
        raise InputError(f"{path}: {names} cuts its lines into rows of numbers; delimiter decides")
    return fitting[0]


def is_text_line(line: str, settings: ThermalCsvSettings) -> bool:
    """Whether a line begins with a word and is no row of pixels; marks of missing pixels may be letters too."""
    first = CELL_ENDS.split(line, maxsplit=1)[0].strip("\"' ")
    return LETTER.match(first) is not None and first not in settings.missing


def frames_in(path: Path, lines: Sequence[str], delimiter: str, settings: ThermalCsvSettings) -> list[PixelFrame]:
    """Split the lines of a file into frames."""
    frames = [PixelFrame(path, 1)]
    for number, line in enumerate(lines, start=1):
        if SEP_LINE.match(line):
            continue
        cells = strip_cells(line.split(delimiter))
        if not cells or is_text_line(line, settings):
            if frames[-1].rows:
                frames.append(PixelFrame(path, number + 1))
            if cells:
                note_named_value(frames[-1], number, cells)
            continue
        if not frames[-1].rows:
            frames[-1].line = number
        frames[-1].rows.append(line)
    return [frame for frame in frames if frame.rows]


def note_named_value(frame: PixelFrame, line: int, cells: Sequence[str]) -> None:
    """Store the named value of a line between frames: `Time = ...`, `Emissivity: 0.95`, `width;640`."""
    match = NAME_VALUE.fullmatch(cells[0])
    name, value = (match[1], match[2]) if match else (cells[0], "")
    frame.above.append(Aside(line, name.strip("\"'"), value or " ".join(cells[1:2])))


def frames_of_one_size(frames: list[PixelFrame], delimiter: str) -> tuple[list[PixelFrame], int, list[str]]:
    """Check that frames have one size; an incomplete last frame is left out. Returns frames, width and remarks.

    Raises
    ------
    InputError : no frame, or a frame of another size before the last.
    """
    if not frames:
        raise InputError("no frame of numbers was found")
    sizes = [{len(strip_cells(row.split(delimiter))) for row in frame.rows} for frame in frames]
    width, height = max(sizes[0]), len(frames[0].rows)
    remarks = []
    last = frames[-1]
    if len(frames) > 1 and (len(last.rows) < height or min(sizes[-1]) < width):
        remarks.append(f"the last frame, from line {last.line} on, is cut short: left out")
        frames, sizes = frames[:-1], sizes[:-1]
    for frame, widths in zip(frames, sizes, strict=True):
        if widths != {width} or len(frame.rows) != height:
            shape = f"{len(frame.rows)} rows of {' or '.join(map(str, sorted(widths)))} cells"
            raise InputError(f"{frame.path}: line {frame.line}: a frame of {shape}; {height} of {width} were expected")
    return frames, width, remarks


def region_cells(
    frames: Sequence[PixelFrame], delimiter: str, width: int, settings: ThermalCsvSettings
) -> dict[str, list[list[str]]]:
    """The cells of each region, by frame.

    Raises
    ------
    InputError : a region lies outside the frames.
    """
    height = len(frames[0].rows)
    spans: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {}
    for name, region in settings.regions.items():
        spans[name] = span_of(region)
        if spans[name][0][1] >= height or spans[name][1][1] >= width:
            raise InputError(f"{frames[0].path}: region {name} goes past the frames of {height} rows, {width} columns")
    needed = sorted({row for rows, _ in spans.values() for row in range(rows[0], rows[1] + 1)})
    cells: dict[str, list[list[str]]] = {name: [] for name in spans}
    for frame in frames:
        split = {row: frame.rows[row].split(delimiter) for row in needed}
        for name, (rows, columns) in spans.items():
            rows_of_region = [split[row][columns[0] : columns[1] + 1] for row in range(rows[0], rows[1] + 1)]
            cells[name].append([cell for row_cells in rows_of_region for cell in row_cells])
    return cells


def span_of(region: CameraRegion) -> tuple[tuple[int, int], tuple[int, int]]:
    """First and last row, first and last column."""
    assert region.rows is not None
    assert region.columns is not None
    return region.rows, region.columns


def stamp_of(frame: PixelFrame, name: str) -> str:
    """The named value above a frame that holds its time.

    Raises
    ------
    InputError : there is no value of that name, or several.
    """
    values = [aside.value for aside in frame.above if aside.name == name]
    if len(values) != 1:
        has = ", ".join(repr(aside.name) for aside in frame.above) or "nothing"
        raise InputError(f"{frame.path}: the frame from line {frame.line} on has {has} above it, not one {name!r}")
    return values[0]
