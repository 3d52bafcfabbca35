"""Read text files of other programs as tables: detect encoding and delimiter, find the headings, check every row.

The caller names the headings that it needs. The delimiter is the one under which some line has all of them, so that a
file of another layout is refused.
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

MOST_CHARACTERS = 1 << 25  # of one file: 1.6 million rows of a camera, which take 1 GB of memory
MOST_BYTES = 2 * MOST_CHARACTERS  # of the same in UTF-16
MOST_PREAMBLE = 1000  # lines
MOST_FAULTS = 5
HEAD_BYTES = 1 << 12  # by which an encoding is detected
SHOWN_BYTES = 60  # before and after a byte that is in another encoding
READINGS = ("cp1252", "cp949", "shift_jis", "gbk")  # of such bytes: Western, Korean, Japanese and Chinese Windows
DELIMITERS = (",", ";", "\t", "|")
DELIMITER_NAMES = {"\t": "tab"}
BOMS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
SEP_LINE = re.compile(r"\s*\"?sep=(.)\"?\s*\Z", re.IGNORECASE)
UNIT_IN_BRACKETS = re.compile(r"\s*[\[(\uff08]([^\[\]()]*)[\])\uff09]\s*\Z")
STAMPED = re.compile(r"[^:=]*[0-9]\s*:[0-9]")  # `PM 12:00:00`, which is no aside
HALF_CELLS = re.compile(r"([^,]*[0-9],[0-9]+,)*[^,]*[0-9],[0-9]+,*\s*")  # `10:00:00,5,25,31`: two numbers
ASIDE = re.compile(r"\s*([^\W\d][^:=]*?)\s*[:=]\s*(.*)", re.DOTALL)  # `Emissivity: 0.95`, `Time = 12:00`


@dataclass
class Aside:
    """A line outside the table with a name and a value: `Emissivity: 0.95`."""

    line: int
    name: str
    value: str


@dataclass
class Table:
    """Rows of text under headings."""

    path: Path
    headings: list[str]
    rows: list[list[str]] = field(default_factory=list)
    lines: array = field(default_factory=lambda: array("q"))  # type: ignore[type-arg]
    asides: list[Aside] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    repeated_headers: int = 0

    def place(self, heading: str, row: int) -> str:
        """File, line and column of a cell for messages."""
        return cell_place(self.path, self.lines[row], heading)

    def heading(self, wanted: str) -> str:
        """The full heading, with its unit, of a column.

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
        """Cells of one column."""
        at = self.headings.index(self.heading(wanted))
        return [row[at] for row in self.rows]


def column_names(heading: str) -> set[str]:
    """Names of a column: its heading with and without the unit in brackets."""
    return {heading, UNIT_IN_BRACKETS.sub("", heading)}


def unit_of(heading: str) -> str:
    """The unit in brackets at the end of a heading; empty if there is none."""
    match = UNIT_IN_BRACKETS.search(heading)
    return match[1].strip() if match else ""


def common_unit(heading: str, in_cells: Sequence[str], column: str) -> str:
    """The common unit of a heading and its cells; empty if neither has one.

    Raises
    ------
    InputError : several units; the message begins with `column`.
    """
    named = sorted({unit_of(heading), *in_cells} - {""})
    if len(named) > 1:
        raise InputError(f"{column} holds numbers in {' and '.join(named)}")
    return "".join(named)


def cell_place(path: Path, line: int, column: str | int) -> str:
    """File, line and column of a cell for messages."""
    return f"{path}: line {line}, column {column!r}"


@contextmanager
def open_text(path: Path, encoding: str, most: int | None = None, advice: str = "") -> Iterator[TextIO]:
    """Open a text of at most so many bytes, with its line ends; the advice follows a fault of the encoding.

    Raises
    ------
    InputError : it cannot be opened, is no regular file, is too large, or has another encoding.
    """
    try:
        with TextIOWrapper(open_regular(path, most), encoding, newline="") as stream:
            try:
                yield stream
            except UnicodeDecodeError as error:
                at = stream.buffer.tell() - len(error.object) + error.start  # the last block that was read is at fault
                stream.buffer.seek(max(at - SHOWN_BYTES, 0))
                before, after = stream.buffer.read(min(at, SHOWN_BYTES)), stream.buffer.read(SHOWN_BYTES)
                line = before.split(b"\n")[-1] + after.split(b"\n")[0].rstrip(b"\r")
                readings = " or ".join(f"{line.decode(name, 'replace')!r} in {name}" for name in READINGS)
                seen = f"its line reads {readings}"
                if at == 0 and line.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
                    seen = "it begins as a text in utf-16 does"
                raise InputError(f"{path}: not {encoding} at byte {at}; {seen}{advice}") from None
            except UnicodeError as error:  # UTF-16 without a byte order mark
                raise InputError(f"{path}: not {encoding}: {error}{advice}") from None
    except OSError as error:
        parts = "; export it in parts" if error.errno == errno.EFBIG else ""
        raise InputError(f"{path}: {error.strerror or error}{parts}") from None


def rows_of(
    path: Path, lines: Iterable[str], delimiter: str, strict: bool = False, before: int = 0
) -> Iterator[tuple[int, list[str]]]:
    """Last line and cells of each row below the first lines (`before`); a blank line has no cells.

    Raises
    ------
    InputError : a row that cannot be split into cells, or a quote that does not end with its cell, if `strict`.
    """
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True, strict=strict)
    try:
        for cells in reader:
            yield before + reader.line_num, cells
    except csv.Error as error:
        raise InputError(f"{path}: line {before + reader.line_num}: {error}") from None


def read_text(path: Path, encoding: str | None) -> tuple[str, str]:
    """Text and encoding of a file: by its byte order mark, else as stated, else detected as UTF-16 or UTF-8.

    Raises
    ------
    InputError : absent, empty, too large, not in the stated encoding, or in an encoding that cannot be detected.
    """
    with open_text(path, "latin-1", MOST_BYTES) as stream:  # in which each byte is a character
        head = stream.read(HEAD_BYTES).encode("latin-1")
        even = stream.seek(0, SEEK_END) % 2 == 0
    marked = next((name for mark, name in BOMS if head.startswith(mark)), None)
    if marked and encoding not in (None, marked) and not (encoding == "utf-16" and marked.startswith("utf-16")):
        raise InputError(f"{path}: begins with the mark of {marked}; encoding says {encoding}")
    chosen = marked or encoding or ("utf-16-le" if even and looks_like_utf16(head) else "utf-8")
    with open_text(path, chosen, MOST_BYTES, "" if marked or encoding else "; encoding decides") as stream:
        text = stream.read()
    if len(text) > MOST_CHARACTERS:
        raise InputError(f"{path}: {len(text)} characters; at most {MOST_CHARACTERS} are read; export it in parts")
    text = text.removeprefix("\ufeff")
    if not text.strip("\0 \r\n\t"):
        nothing = f"holds nothing but {f'the mark of {marked}' if marked else 'blanks'}"
        raise InputError(f"{path}: {nothing if head else 'empty'}")
    if "\0" in text:
        raise InputError(f"{path}: line {text.count(chr(10), 0, text.index(chr(0))) + 1}: NUL in the text; damaged?")
    return text, chosen


def looks_like_utf16(head: bytes) -> bool:
    """Whether many odd bytes and no even byte are NUL, as in Latin text in UTF-16 without a byte order mark."""
    return head[1::2].count(0) > 0.4 * len(head) and head[0::2].count(0) == 0


def read_table(path: Path, form: TableFormat, wanted: Sequence[str], every_row: bool = False) -> Table:
    """Read the table with the wanted headings; with `every_row`, empty rows are kept because row numbers give the time.

    Raises
    ------
    InputError : no line has the headings, several delimiters fit, or rows have another number of cells.
    """
    text, encoding = read_text(path, form.encoding)
    lines = text.splitlines(keepends=True)
    first, declared = 0, SEP_LINE.match(lines[0])
    if declared:
        first = 1
    candidates = [form.delimiter] if form.delimiter else [declared[1]] if declared else [*DELIMITERS]
    headers = [
        (delimiter, at) for delimiter in candidates if (at := find_header(lines, first, delimiter, wanted)) is not None
    ]
    if not headers:
        raise InputError(f"{path}: {missing_headings(lines[first:], candidates, wanted)}")
    if len(headers) > 1:
        names = " or ".join(DELIMITER_NAMES.get(delimiter, repr(delimiter)) for delimiter, _ in headers)
        raise InputError(f"{path}: the headings are found with {names} between cells; delimiter decides")
    delimiter, at = headers[0]
    if delimiter == form.decimal:
        delimiter, lines = ";", join_halves(lines)
    table = Table(path, [])
    table.remarks.append(
        f"{encoding}, {DELIMITER_NAMES.get(delimiter, repr(delimiter))} between cells, headings in line {at + 1}"
    )
    for k, line in enumerate(lines[first:at], start=first + 1):
        note_aside(table, k, strip_cells(line.split(delimiter)))
    read_rows(table, lines[at:], at, delimiter, every_row)
    if table.rows and not text.endswith(("\n", "\r")) and table.lines[-1] == len(lines):
        table.remarks.append(f"the last row, line {table.lines.pop()}, has no end and may be cut: left out")
        table.rows.pop()
    if not table.rows:
        raise InputError(f"{path}: no row below the headings of line {at + 1}")
    return table


def cells_of(line: str, delimiter: str) -> list[str]:
    """The cells of one line."""
    with suppress(InputError):
        return next(rows_of(Path(), [line], delimiter), (0, list[str]()))[1]
    return []


def join_halves(lines: Sequence[str]) -> list[str]:
    """Lines of comma-separated cells with semicolons; numbers that a decimal comma cuts into two cells are joined.

    A line with quotes keeps its cells, since its program quotes numbers with a comma.
    """
    joined = []
    for line in lines:
        plain = line.rstrip("\r\n")
        cells = cells_of(plain, ",")
        if '"' not in plain and HALF_CELLS.fullmatch(plain):
            filled = strip_cells(cells)
            cells = [",".join(filled[at : at + 2]) for at in range(0, len(filled), 2)] + cells[len(filled) :]
        row = StringIO()
        csv.writer(row, delimiter=";", lineterminator=line[len(plain) :]).writerow(cells)
        joined.append(row.getvalue())
    return joined


def find_header(lines: Sequence[str], first: int, delimiter: str, wanted: Sequence[str]) -> int | None:
    """Index of the first line with all wanted headings; None if there is none."""
    needles = set(wanted)
    for at in range(first, min(len(lines), first + MOST_PREAMBLE)):
        if needles <= {name for cell in cells_of(lines[at], delimiter) for name in column_names(cell.strip())}:
            return at
    return None


def missing_headings(lines: Sequence[str], candidates: Sequence[str], wanted: Sequence[str]) -> str:
    """Message for missing headings: those wanted, and the cells of the most similar line."""
    rows = [
        cells
        for delimiter in candidates
        for line in lines[:50]
        if (cells := [cell.strip() for cell in cells_of(line, delimiter) if cell.strip()])
        and sum(any(c.isalpha() for c in cell) for cell in cells) > len(cells) / 2
    ]
    best = max(
        rows, key=lambda cells: (sum(bool(column_names(cell) & {*wanted}) for cell in cells), len(cells)), default=[]
    )
    has = ", ".join(map(repr, best[:40])) or "no line that looks like headings"
    lacking = [repr(name) for name in wanted if all(name not in column_names(cell) for cell in best)]
    return f"no line has the headings {', '.join(lacking)}; the file has {has}"


def read_rows(table: Table, lines: Sequence[str], before: int, delimiter: str, every_row: bool) -> None:
    """Read all lines from the headings on; each is a row, repeated headings, an aside, blank, or a fault."""
    reader = rows_of(table.path, lines, delimiter, before=before)
    last_line, cells = next(reader)
    headings = table.headings = strip_cells(cells)
    if repeated := sorted({name for name in headings if name and headings.count(name) > 1}):
        table.remarks.append(f"headings that stand twice: {', '.join(repeated)}")
    width, faults = len(headings), list[str]()
    uneven: tuple[int, list[str]] | None = None  # a row that only the file's end excuses
    empty: list[tuple[int, list[str]]] = []  # rows without a number, which count where others follow
    for line, cells in reader:
        if line > last_line + 1:
            raise InputError(f"{table.path}: line {last_line + 1}: a quote opens a cell that does not end in its line")
        last_line = line
        if '"' in lines[line - before - 1] and any('"' in cell for cell in cells):
            table.remarks.append(f"line {line}: a quote stands in a cell, whose cells may not end where they should")
        if len(cells) != width or not cells[0][:1].isdigit() or cells[0] == headings[0]:
            filled = strip_cells(cells)
            if not filled:
                if every_row and len(cells) >= width:
                    empty.append((line, cells))
                continue
            if filled == headings:
                table.repeated_headers += 1
                empty.clear()
                continue
            if not STAMPED.match(filled[0]) and note_aside(table, line, filled):
                continue
        if uneven is not None:
            faults.append(width_fault(table.path, *uneven, width, delimiter))
            uneven = None
            if len(faults) == MOST_FAULTS:
                break
        for number, row in (*empty, (line, cells)):
            if width_fault(table.path, number, row, width):
                uneven = number, row
            else:
                table.rows.append(row)
                table.lines.append(number)
        empty.clear()
    if uneven is not None and len(uneven[1]) > width:
        faults.append(width_fault(table.path, *uneven, width, delimiter))
    elif uneven is not None:
        table.remarks.append(f"the last row, line {uneven[0]}, ends after {len(uneven[1])} of {width} cells: left out")
    if faults:
        raise InputError(faults)


def strip_cells(cells: Sequence[str]) -> list[str]:
    """Strip the cells and drop empty ones at the end."""
    kept = [cell.strip() for cell in cells]
    while kept and not kept[-1]:
        kept.pop()
    return kept


def width_fault(path: Path, line: int, cells: Sequence[str], width: int, detected: str = "") -> str:
    """Message for a row with another number of cells than its table; empty cells at the end of a row do not count.

    A comma as detected delimiter may be a decimal comma that the setting `decimal` joins.
    """
    if len(cells) == width or len(strip_cells(cells)) <= width <= len(cells):
        return ""
    hint = "; is a decimal comma taken for the delimiter?" if len(cells) > width else ""
    if hint and detected == ",":
        hint += " decimal: ',' joins such cells"
    return f"{path}: line {line}: {len(cells)} cells where {width} were expected{hint}"


def note_aside(table: Table, line: int, cells: Sequence[str]) -> bool:
    """Store a line of the form `name: value`; returns whether the line has that form."""
    filled_cells = [cell for cell in cells if cell]
    match = ASIDE.fullmatch(filled_cells[0].strip('"')) if 0 < len(filled_cells) <= 2 else None
    if match is None:
        return False
    value = match[2] or (filled_cells[1] if len(filled_cells) > 1 else "")
    table.asides.append(Aside(line, match[1], value.strip()))
    return True
