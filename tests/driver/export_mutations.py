"""Damage to camera exports as editors, spreadsheets, converters and full disks do it; no digit is changed.

Pixels, and rows of pixels that nothing numbers, do not change places within their frame: no reader could know, as with
a changed digit.
"""

import random
import re
from collections.abc import Callable

import numpy as np

from leactl.errors import InputError

ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252", "cp949", "shift_jis", "gb18030")
DELIMITERS = ",;\t| "
NUMBER_LINE = re.compile(r"[\"'\w ]*[,;\t]?[\"']?[0-9][0-9.,;:\t\"' |-]*[\r\n]*")
DESCRIBED = re.compile(  # by remarks that every record has; they are no warning
    r"between cells|^\d+ frames of|^decimal |^temperatures in|^one row each|resolved to|^frame numbers|elapsed time"
)


def damaged_line(lines, number, line):
    return [*lines[:number], line, *lines[number + 1 :]]


def some_place(rng, line, marks):
    """A random place of one of these characters in a line; None if it has none."""
    places = [at for at, character in enumerate(line) if character in marks]
    return rng.choice(places) if places else None


def drop_line(rng, lines, ordered):
    number = rng.randrange(len(lines))
    return lines[:number] + lines[number + 1 :]


def double_line(rng, lines, ordered):
    number = rng.randrange(len(lines))
    return [*lines[: number + 1], *lines[number:]]


def swap_lines(rng, lines, ordered):
    first, second = sorted(rng.sample(range(len(lines)), 2))
    if not ordered and all(NUMBER_LINE.fullmatch(lines[at]) or not lines[at].strip() for at in (first, second)):
        return drop_line(rng, lines, ordered)
    swapped = list(lines)
    swapped[first], swapped[second] = lines[second], lines[first]
    return swapped


def blank_line(rng, lines, ordered):
    number = rng.randrange(len(lines) + 1)
    return [*lines[:number], rng.choice(["\n", "\r\n", ",,,\n", ";\n", " \n"]), *lines[number:]]


def on_cells(change: Callable) -> Callable:
    """Damage to one cell of one line."""

    def mutation(rng, lines, ordered):
        number = rng.randrange(len(lines))
        line = lines[number]
        mark = next((mark for mark in ";\t" if mark in line), ",")
        cells = line.split(mark)
        at = rng.randrange(len(cells))
        return damaged_line(lines, number, mark.join([*cells[:at], *change(cells[at]), *cells[at + 1 :]]))

    return mutation


def on_marks(marks: str, change: Callable) -> Callable:
    """Damage to one character of these."""

    def mutation(rng, lines, ordered):
        number = rng.randrange(len(lines))
        line = lines[number]
        at = some_place(rng, line, marks)
        if at is None:
            return drop_line(rng, lines, ordered)
        return damaged_line(lines, number, line[:at] + change(rng, line[at]) + line[at + 1 :])

    return mutation


def all_marks(rng, lines, ordered):
    """Another delimiter or decimal mark throughout."""
    old, new = rng.sample(",;.\t", 2)
    return [line.replace(old, new) for line in lines]


def exchanged_marks(rng, lines, ordered):
    """Points and commas exchanged throughout."""
    return [line.translate({ord("."): ",", ord(","): "."}) for line in lines]


def change_word(rng, lines, ordered):
    """A letter changed or lost outside the rows of numbers, so that no other unit comes of it."""
    numbers = [number for number, line in enumerate(lines) if any(map(str.isalpha, line))]
    if not numbers:
        return double_line(rng, lines, ordered)
    number = rng.choice(numbers)
    line = lines[number]
    at = rng.choice([at for at, character in enumerate(line) if character.isalpha()])
    return damaged_line(lines, number, line[:at] + rng.choice(["", "q", "x", "#"]) + line[at + 1 :])


def insert_text(rng, lines, ordered):
    number = rng.randrange(len(lines))
    line, at = lines[number], rng.randrange(len(lines[number]) + 1)
    return damaged_line(lines, number, line[:at] + rng.choice(['"', "'", " ", "\0", "+", "e", "?"]) + line[at:])


def line_ends(rng, lines, ordered):
    end = rng.choice(["\n", "\r\n", "\r", "\r\r\n", "\n\n"])
    return [line.rstrip("\r\n") + end for line in lines]


TEXT_MUTATIONS = {
    "drop line": drop_line,
    "double line": double_line,
    "swap lines": swap_lines,
    "blank line": blank_line,
    "drop cell": on_cells(lambda cell: []),
    "double cell": on_cells(lambda cell: [cell, cell]),
    "empty cell": on_cells(lambda cell: [""]),
    "insert cell": on_cells(lambda cell: ["", cell]),
    "drop delimiter": on_marks(",;\t", lambda rng, mark: ""),
    "double delimiter": on_marks(",;\t", lambda rng, mark: mark * 2),
    "change delimiter": on_marks(",;\t", lambda rng, mark: rng.choice(DELIMITERS)),
    "drop mark": on_marks(".,", lambda rng, mark: ""),
    "double mark": on_marks(".,", lambda rng, mark: mark * 2),
    "change mark": on_marks(".,", lambda rng, mark: rng.choice(".,' ")),
    "all marks": all_marks,
    "exchanged marks": exchanged_marks,
    "change word": change_word,
    "insert text": insert_text,
    "line ends": line_ends,
}


def recode(rng, content, encoding):
    return content.decode(encoding, "replace").encode(rng.choice(ENCODINGS), "replace")


def truncate(rng, content, encoding):
    return content[: rng.randrange(len(content))]


def wrong_byte(rng, content, encoding):
    at = rng.randrange(len(content))
    return content[:at] + bytes([rng.randrange(128, 256)]) + content[at + rng.randrange(2) :]


BYTE_MUTATIONS = {"recode": recode, "truncate": truncate, "wrong byte": wrong_byte}
KINDS = [*TEXT_MUTATIONS, *BYTE_MUTATIONS]
OF_WHOLE_FILES = [None, None, None, "line ends", "recode"]  # which may come on top


def mutated(export, seed):
    """Names of one mutation, or of one and another of the whole file, and the files of an export after them."""
    rng = random.Random(f"{export.name} {seed}")
    files = export.files()
    at = rng.randrange(len(files))
    kinds = [kind for kind in (rng.choice(KINDS), rng.choice(OF_WHOLE_FILES)) if kind is not None]
    for kind in sorted(kinds, key=KINDS.index):
        if kind in BYTE_MUTATIONS:
            files[at] = BYTE_MUTATIONS[kind](rng, files[at], export.encoding)
        elif lines := files[at].decode(export.encoding, "replace").splitlines(keepends=True):
            files[at] = "".join(TEXT_MUTATIONS[kind](rng, lines, export.ordered)).encode(export.encoding, "replace")
    return kinds, files


def outcome(export, folder, files, right):
    """What becomes of files: "refused", "same", "told", or "wrong" values without a note.

    Parameters
    ----------
    right : the record of the export as its program wrote it.
    """
    try:
        record = export.read(folder, files)
    except InputError as refused:
        assert all("export_" in fault and "\n" not in fault for fault in refused.faults), refused.faults
        return "refused"
    if agrees(record, right, stamped=not export.time.keys() <= {"frame_rate_Hz"}):
        return "same"
    notes = [text for text in record.remarks if text not in right.remarks and not DESCRIBED.search(text)]
    return "told" if notes else "wrong"


def agrees(record, right, stamped):
    """Whether each number stands in the right record at its time; a stamped record may have lost its first rows."""
    if record.began is not None and right.began is not None:
        shifts = [record.began - right.began]
    else:
        shifts = list(right.time) if stamped else [0.0]
    for shift in shifts:
        nearest = np.abs(record.time[:, np.newaxis] + shift - right.time).argmin(axis=1)
        in_time = np.abs(record.time + shift - right.time[nearest]) < 1e-3
        equal = np.isnan(record.values) | (np.abs(record.values - right.values[nearest]) < 1e-9)
        if in_time.all() and equal.all():
            return True
    return False
