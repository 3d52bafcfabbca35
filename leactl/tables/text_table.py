"""Read text files of other programs as tables: detect encoding and delimiter, find the headings, check every row.

The caller names the headings that it needs. The delimiter is the one that splits some line into cells with all of these
headings, so that a file of another layout is refused.
"""

import codecs
import csv
import errno
import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from io import SEEK_END, StringIO, TextIOWrapper
from pathlib import Path
from typing import TextIO

from leactl.errors import InputError
from leactl.regular_files import open_regular
from leactl.tables.number_format import TableFormat

MOST_CHARACTERS = 1 << 25  # of a file: 1.6 million rows of a thermal camera's export, which take 1 GB of memory
MOST_BYTES = 2 * MOST_CHARACTERS  # of a file in UTF-16
MOST_PREAMBLE_LINES = 1000  # lines before the headings
MOST_FAULTS = 5  # faults that one error lists
HEAD_BYTES = 1 << 12  # first bytes of a file, from which its encoding is detected
SHOWN_BYTES = 60  # bytes in a message before and after a byte that the encoding does not allow
# encodings in which a message shows these bytes: Western, Korean, Japanese and Chinese Windows
SHOWN_ENCODINGS = ("cp1252", "cp949", "shift_jis", "gbk")
DELIMITERS = (",", ";", "\t", "|")
DELIMITER_NAMES = {"\t": "tab"}
BOMS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
SEP_LINE = re.compile(r"\s*\"?sep=(.)\"?\s*\Z", re.IGNORECASE)
UNIT_IN_BRACKETS = re.compile(r"\s*[\[(\uff08]([^\[\]()]*)[\])\uff09]\s*\Z")
TIME_OF_DAY = re.compile(r"[^:=]*[0-9]\s*:[0-9]")  # `PM 12:00:00`: a time, which is not an aside
SPLIT_DECIMALS = re.compile(r"([^,]*[0-9],[0-9]+,)*[^,]*[0-9],[0-9]+,*\s*")  # `10:00:00,5,25,31`: decimal commas
ASIDE = re.compile(r"\s*([^\W\d][^:=]*?)\s*[:=]\s*(.*)", re.DOTALL)  # `Emissivity: 0.95`, `Time = 12:00`


@dataclass
class Aside:
    """A line outside the table with a name and a value: `Emissivity: 0.95`."""

    line: int
    name: str
    value: str


@dataclass
class Table:
    """A table of text: headings, rows, asides, and remarks on how the file was read."""

    path: Path
    headings: list[str]
    rows: list[list[str]] = field(default_factory=list)
    # number of each row's last line in the file
    lines: array = field(default_factory=lambda: array("q"))  # type: ignore[type-arg]
    asides: list[Aside] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    repeated_headers: int = 0

    def location(self, heading: str, row: int) -> str:
        """Return file, line and column of a cell, for messages."""
        return cell_location(self.path, self.lines[row], heading)

    def heading(self, wanted: str) -> str:
        """Return the full heading, with its unit, of the column with this name.

        Raises
        ------
        InputError : several columns have this name.
        """
        matches = [heading for heading in self.headings if wanted in column_names(heading)]
        if len(matches) > 1:
            raise InputError(
                f"{self.path}: {wanted!r} stands over {len(matches)} columns: {', '.join(map(repr, matches))}"
            )
        return matches[0]

    def column(self, wanted: str) -> list[str]:
        """Return the cells of the column with this name.

        Raises
        ------
        InputError : several columns have this name.
        """
        index = self.headings.index(self.heading(wanted))
        return [row[index] for row in self.rows]


def column_names(heading: str) -> set[str]:
    """Return the names of a column: its heading with and without the unit in brackets."""
    return {heading, UNIT_IN_BRACKETS.sub("", heading)}


def unit_of(heading: str) -> str:
    """Return the unit in brackets at the end of a heading; empty if there is none."""
    match = UNIT_IN_BRACKETS.search(heading)
    return match[1].strip() if match else ""


def common_unit(heading: str, units_in_cells: Sequence[str], column: str) -> str:
    """Return the unit that a heading and its cells share; empty if neither has a unit.

    Raises
    ------
    InputError : heading and cells have different units; the message begins with `column`.
    """
    units = sorted({unit_of(heading), *units_in_cells} - {""})
    if len(units) > 1:
        raise InputError(f"{column} holds numbers in {' and '.join(units)}")
    return "".join(units)


def cell_location(path: Path, line: int, column: str | int) -> str:
    """Return file, line and column of a cell, for messages."""
    return f"{path}: line {line}, column {column!r}"


@contextmanager
def open_text(path: Path, encoding: str, most_bytes: int | None = None, advice: str = "") -> Iterator[TextIO]:
    """Open a text file and keep its line ends.

    Parameters
    ----------
    most_bytes : largest size of the file; None for no limit.
    advice : end of the message on a file that is not in the encoding.

    Raises
    ------
    InputError : the file cannot be opened, is no regular file, is too large, or is not in the encoding.
    """
    try:
        with TextIOWrapper(open_regular(path, most_bytes), encoding, newline="") as stream:
            try:
                yield stream
            except UnicodeDecodeError as error:
                # the error counts from the start of the block that was read last
                position = stream.buffer.tell() - len(error.object) + error.start
                stream.buffer.seek(max(position - SHOWN_BYTES, 0))
                bytes_before, bytes_after = (
                    stream.buffer.read(min(position, SHOWN_BYTES)),
                    stream.buffer.read(SHOWN_BYTES),
                )
                line = bytes_before.split(b"\n")[-1] + bytes_after.split(b"\n")[0].rstrip(b"\r")
                readings = " or ".join(f"{line.decode(name, 'replace')!r} in {name}" for name in SHOWN_ENCODINGS)
                finding = f"its line reads {readings}"
                if position == 0 and line.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
                    finding = "it begins as a text in utf-16 does"
                raise InputError(f"{path}: not {encoding} at byte {position}; {finding}{advice}") from None
            except UnicodeError as error:  # UTF-16 without a byte order mark
                raise InputError(f"{path}: not {encoding}: {error}{advice}") from None
    except OSError as error:
        hint = "; export it in parts" if error.errno == errno.EFBIG else ""
        raise InputError(f"{path}: {error.strerror or error}{hint}") from None


def rows_of(
    path: Path, lines: Iterable[str], delimiter: str, strict: bool = False, lines_before: int = 0
) -> Iterator[tuple[int, list[str]]]:
    """Yield number of the last line and cells of each row; a blank line is a row without cells.

    Parameters
    ----------
    strict : whether a quoted cell has to end with its closing quote.
    lines_before : number of lines of the file before the first of `lines`.

    Raises
    ------
    InputError : a row cannot be split into cells, or, if `strict`, a quoted cell does not end with its quote.
    """
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True, strict=strict)
    try:
        for cells in reader:
            yield lines_before + reader.line_num, cells
    except csv.Error as error:
        raise InputError(f"{path}: line {lines_before + reader.line_num}: {error}") from None


def read_text(path: Path, encoding: str | None) -> tuple[str, str]:
    """Return text and encoding of a file: by its byte order mark, else as stated, else detected as UTF-16 or UTF-8.

    Raises
    ------
    InputError : the file is absent, empty or too large, is not in the stated encoding, or its encoding cannot be
        detected.
    """
    with open_text(path, "latin-1", MOST_BYTES) as stream:  # latin-1 has a character for each byte
        first_bytes = stream.read(HEAD_BYTES).encode("latin-1")
        has_even_size = stream.seek(0, SEEK_END) % 2 == 0
    bom_encoding = next((name for mark, name in BOMS if first_bytes.startswith(mark)), None)
    is_either_utf16 = encoding == "utf-16" and bom_encoding is not None and bom_encoding.startswith("utf-16")
    if bom_encoding and encoding not in (None, bom_encoding) and not is_either_utf16:
        raise InputError(f"{path}: begins with the mark of {bom_encoding}; encoding says {encoding}")
    chosen = bom_encoding or encoding or ("utf-16-le" if has_even_size and looks_like_utf16(first_bytes) else "utf-8")
    with open_text(path, chosen, MOST_BYTES, "" if bom_encoding or encoding else "; encoding decides") as stream:
        text = stream.read()
    if len(text) > MOST_CHARACTERS:
        raise InputError(f"{path}: {len(text)} characters; at most {MOST_CHARACTERS} are read; export it in parts")
    text = text.removeprefix("\ufeff")
    if not text.strip("\0 \r\n\t"):
        content = f"holds nothing but {f'the mark of {bom_encoding}' if bom_encoding else 'blanks'}"
        raise InputError(f"{path}: {content if first_bytes else 'empty'}")
    if "\0" in text:
        raise InputError(f"{path}: line {text.count(chr(10), 0, text.index(chr(0))) + 1}: NUL in the text; damaged?")
    return text, chosen


def looks_like_utf16(first_bytes: bytes) -> bool:
    """Return whether many odd bytes and no even byte are NUL, as in Latin text in UTF-16 without a byte order mark."""
    return first_bytes[1::2].count(0) > 0.4 * len(first_bytes) and first_bytes[0::2].count(0) == 0


def read_table(path: Path, form: TableFormat, wanted: Sequence[str], every_row: bool = False) -> Table:
    """Read the table that has the wanted headings.

    Parameters
    ----------
    every_row : whether rows without a number are rows of the table, because row numbers give the time.

    Raises
    ------
    InputError : no line has the headings, several delimiters fit, or rows have too many or too few cells.
    """
    text, encoding = read_text(path, form.encoding)
    lines = text.splitlines(keepends=True)
    sep_line = SEP_LINE.match(lines[0])
    first_line = 1 if sep_line else 0
    candidates = [form.delimiter] if form.delimiter else [sep_line[1]] if sep_line else [*DELIMITERS]
    headers = [
        (delimiter, index)
        for delimiter in candidates
        if (index := find_header(lines, first_line, delimiter, wanted)) is not None
    ]
    if not headers:
        raise InputError(f"{path}: {missing_headings(lines[first_line:], candidates, wanted)}")
    if len(headers) > 1:
        names = " or ".join(DELIMITER_NAMES.get(delimiter, repr(delimiter)) for delimiter, _ in headers)
        raise InputError(f"{path}: the headings are found with {names} between cells; delimiter decides")
    delimiter, header = headers[0]
    if delimiter == form.decimal:
        delimiter, lines = ";", join_halves(lines)
    table = Table(path, [])
    table.remarks.append(
        f"{encoding}, {DELIMITER_NAMES.get(delimiter, repr(delimiter))} between cells, headings in line {header + 1}"
    )
    for number, line in enumerate(lines[first_line:header], start=first_line + 1):
        add_aside(table, number, strip_cells(line.split(delimiter)))
    read_rows(table, lines[header:], header, delimiter, every_row)
    if table.rows and not text.endswith(("\n", "\r")) and table.lines[-1] == len(lines):
        table.remarks.append(f"the last row, line {table.lines.pop()}, has no end and may be cut: left out")
        table.rows.pop()
    if not table.rows:
        raise InputError(f"{path}: no row below the headings of line {header + 1}")
    return table


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line; none if it cannot be split."""
    with suppress(InputError):
        return next(rows_of(Path(), [line], delimiter), (0, list[str]()))[1]
    return []


def join_halves(lines: Sequence[str]) -> list[str]:
    """Return comma-separated lines with semicolons instead, and join numbers that a decimal comma split into two cells.

    A line with quotes keeps its cells: the program that wrote it quotes numbers with a comma.
    """
    joined = []
    for line in lines:
        text = line.rstrip("\r\n")
        cells = cells_of(text, ",")
        if '"' not in text and SPLIT_DECIMALS.fullmatch(text):
            filled_cells = strip_cells(cells)
            cells = [",".join(filled_cells[k : k + 2]) for k in range(0, len(filled_cells), 2)] + cells[
                len(filled_cells) :
            ]
        joined_line = StringIO()
        csv.writer(joined_line, delimiter=";", lineterminator=line[len(text) :]).writerow(cells)
        joined.append(joined_line.getvalue())
    return joined


def find_header(lines: Sequence[str], first_line: int, delimiter: str, wanted: Sequence[str]) -> int | None:
    """Return the index of the first line from `first_line` on that has all wanted headings; None if there is none."""
    wanted_names = set(wanted)
    for index in range(first_line, min(len(lines), first_line + MOST_PREAMBLE_LINES)):
        if wanted_names <= {name for cell in cells_of(lines[index], delimiter) for name in column_names(cell.strip())}:
            return index
    return None


def missing_headings(lines: Sequence[str], candidates: Sequence[str], wanted: Sequence[str]) -> str:
    """Return the message on missing headings: which are missing, and the cells of the most similar line."""
    rows = [
        cells
        for delimiter in candidates
        for line in lines[:50]
        if (cells := [cell.strip() for cell in cells_of(line, delimiter) if cell.strip()])
        and sum(any(c.isalpha() for c in cell) for cell in cells) > len(cells) / 2
    ]
    most_similar = max(
        rows, key=lambda cells: (sum(bool(column_names(cell) & {*wanted}) for cell in cells), len(cells)), default=[]
    )
    present = ", ".join(map(repr, most_similar[:40])) or "no line that looks like headings"
    missing_names = [repr(name) for name in wanted if all(name not in column_names(cell) for cell in most_similar)]
    return f"no line has the headings {', '.join(missing_names)}; the file has {present}"


def read_rows(table: Table, lines: Sequence[str], lines_before: int, delimiter: str, every_row: bool) -> None:
    """Add the lines from the headings on to a table: each is a row, repeated headings, an aside, or blank.

    Parameters
    ----------
    lines_before : number of lines of the file before the headings.

    Raises
    ------
    InputError : rows have too many or too few cells, or a quoted cell does not end in its line.
    """
    reader = rows_of(table.path, lines, delimiter, lines_before=lines_before)
    last_line, cells = next(reader)
    headings = table.headings = strip_cells(cells)
    if repeated_headings := sorted({name for name in headings if name and headings.count(name) > 1}):
        table.remarks.append(f"headings that stand twice: {', '.join(repeated_headings)}")
    width, faults = len(headings), list[str]()
    # number of the last line and cells of a row of another width, which is no fault at the end of the file
    uneven_row: tuple[int, list[str]] | None = None
    rows_without_number: list[tuple[int, list[str]]] = []  # rows without a number, which count if another row follows
    for line, cells in reader:
        if line > last_line + 1:
            raise InputError(f"{table.path}: line {last_line + 1}: a quote opens a cell that does not end in its line")
        last_line = line
        if '"' in lines[line - lines_before - 1] and any('"' in cell for cell in cells):
            table.remarks.append(f"line {line}: a quote stands in a cell, whose cells may not end where they should")
        if len(cells) != width or not cells[0][:1].isdigit() or cells[0] == headings[0]:
            filled_cells = strip_cells(cells)
            if not filled_cells:
                if every_row and len(cells) >= width:
                    rows_without_number.append((line, cells))
                continue
            if filled_cells == headings:
                table.repeated_headers += 1
                rows_without_number.clear()
                continue
            if not TIME_OF_DAY.match(filled_cells[0]) and add_aside(table, line, filled_cells):
                continue
        if uneven_row is not None:
            faults.append(width_fault(table.path, *uneven_row, width, delimiter))
            uneven_row = None
            if len(faults) == MOST_FAULTS:
                break
        for number, row in (*rows_without_number, (line, cells)):
            if width_fault(table.path, number, row, width):
                uneven_row = number, row
            else:
                table.rows.append(row)
                table.lines.append(number)
        rows_without_number.clear()
    if uneven_row is not None and len(uneven_row[1]) > width:
        faults.append(width_fault(table.path, *uneven_row, width, delimiter))
    elif uneven_row is not None:
        table.remarks.append(
            f"the last row, line {uneven_row[0]}, ends after {len(uneven_row[1])} of {width} cells: left out"
        )
    if faults:
        raise InputError(faults)


def strip_cells(cells: Sequence[str]) -> list[str]:
    """Return the cells without surrounding blanks, and without empty cells at the end."""
    stripped = [cell.strip() for cell in cells]
    while stripped and not stripped[-1]:
        stripped.pop()
    return stripped


def width_fault(path: Path, line: int, cells: Sequence[str], width: int, detected: str = "") -> str:
    """Return the message on a row with another number of cells than its table; empty if the number is right.

    Empty cells at the end of a row do not count. `detected` is the delimiter if it was detected; if it is a comma, the
    message says how to read decimal commas.
    """
    if len(cells) == width or len(strip_cells(cells)) <= width <= len(cells):
        return ""
    hint = "; is a decimal comma taken for the delimiter?" if len(cells) > width else ""
    if hint and detected == ",":
        hint += " decimal: ',' joins such cells"
    return f"{path}: line {line}: {len(cells)} cells where {width} were expected{hint}"


def add_aside(table: Table, line: int, cells: Sequence[str]) -> bool:
    """Add a line of the form `name: value` to the asides of a table; return whether the line has that form."""
    filled_cells = [cell for cell in cells if cell]
    match = ASIDE.fullmatch(filled_cells[0].strip('"')) if 0 < len(filled_cells) <= 2 else None
    if match is None:
        return False
    value = match[2] or (filled_cells[1] if len(filled_cells) > 1 else "")
    table.asides.append(Aside(line, match[1], value.strip()))
    return True
