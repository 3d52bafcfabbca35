"""The index of a folder of runs: what the list knows of each file, kept so that unchanged files are not opened again.

It is a SQLite file without anything of its own: what it holds was read from the run files and can be read again. A row
counts only where its file is the same by size, times of change and inode as when it was read. The index is read into
memory whole and written as a new file that takes the place of the old one, so that no locks are needed: of two
processes that write at once the later one's file stays.
"""

import json
import os
import sqlite3
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from secrets import token_hex
from typing import Any, Final, NamedTuple, get_type_hints

from leactl.errors import InputError
from leactl.processes import HERE, Workers
from leactl.regular import open_regular
from leactl.runfile.catalog.tags import with_tags
from leactl.runfile.publish import NotWritten, replacement
from leactl.runfile.summary import RECORDING, Summary, is_run_name

NAME: Final = ".leactl-index.sqlite"
APPLICATION: Final = 0x6C656178  # "leax"
VERSION: Final = 1  # raised where what a column means has changed
# SQLite file format, 1.3: what the file begins with, the version of its user, the application that it is of
MAGIC, VERSION_AT, APPLICATION_AT = b"SQLite format 3\0", slice(60, 64), slice(68, 72)
MOST_BYTES: Final = 1 << 30  # some million runs
# what was changed less than this before it was read may change again within one tick of its file system's clock, which
# is 2 s on FAT
YOUNG_NS: Final = 2 * 10**9
DIGITS: Final = 64  # of a SHA-256
BATCH: Final = 32  # runs that are read at a time, some 0.2 s
TOLD_EVERY: Final = 10 * BATCH
MANY: Final = 1000  # files, which take some seconds to open

KNOWN: Final = Summary._fields[1:-1]  # all but the folder, which is where the index is asked about, and the tags
STAMP: Final = ("mtime_ns", "ctime_ns", "inode")
TYPES: Final = {
    **{name: {float: "REAL", int: "INTEGER"}.get(kind, "TEXT") for name, kind in get_type_hints(Summary).items()},
    **dict.fromkeys(("seed", *STAMP), "INTEGER"),
}
# SQLite holds any type in any column
MISTYPED: Final = " OR ".join(
    f"typeof({name}) NOT IN ('{TYPES[name].lower()}'{', ' + repr('null') if name == 'seed' else ''})"
    for name in (*KNOWN, *STAMP)
)

Tell = Callable[[str], None]


def silent(line: str) -> None:
    """Tell nobody."""


class FileStamp(NamedTuple):
    """What a file is the same by."""

    size: int
    mtime_ns: int
    ctime_ns: int
    inode: int


UNSETTLED: Final = FileStamp(0, 0, 0, 0)  # of a file that is read again next time
NOT_THERE: Final = FileStamp(-1, -1, -1, -1)  # of a link that leads nowhere


class Indexed(NamedTuple):
    """What the index holds of a file."""

    stamp: FileStamp
    run: Summary


class Unusable(Exception):
    """Why an index is made anew."""


@dataclass
class Catalogue:
    """The runs of a folder, and what was opened to know them."""

    directory: Path
    rows: dict[str, Indexed] = field(default_factory=dict)  # by file, as the names sort
    read: int = 0  # files that were opened
    gone: int = 0  # files that the index knew and the folder has no more
    changed: bool = False  # whether the index is to be written again
    behind: bool = False  # whether the runs are others than the index had

    @property
    def runs(self) -> list[Summary]:
        """The runs, oldest first as their names sort."""
        return [row.run for row in self.rows.values()]

    def refresh(self, workers: Workers = HERE, tell: Tell = silent) -> None:
        """Open the files that are new or not what they were, and forget those that are gone.

        Where a stop ends it, what was read until then stays.

        Parameters
        ----------
        workers : who opens them.
        tell : is told how many are read.

        Raises
        ------
        InputError : the folder cannot be read.
        """
        known, stamps = self.rows, stamps_of(self.directory)
        self.gone = len(known.keys() - stamps.keys())
        due = [name for name, stamp in stamps.items() if name not in known or known[name].stamp != stamp]
        self.rows = {name: known[name] for name in stamps.keys() - due}
        began = time.time_ns()
        batches = [due[at : at + BATCH] for at in range(0, len(due), BATCH)]
        jobs = [(self.directory, batch) for batch in batches]
        try:
            for done in workers.in_order(_summaries, jobs):
                for run in done.value():
                    stamp = stamps[run.file] if settled(run, stamps[run.file], began) else UNSETTLED
                    self.rows[run.file] = Indexed(stamp, run)
                    self.read += 1
                if self.read % TOLD_EVERY == 0:
                    tell(f"{self.read} of {len(due)} files read")
        finally:
            self.rows = {name: self.rows[name] for name in stamps if name in self.rows}
            self.changed = self.changed or self.rows != known
            if self.changed:
                self.behind = {name: row.run for name, row in known.items()} != {run.file: run for run in self.runs}


def settled(run: Summary, stamp: FileStamp, read_ns: int) -> bool:
    """Whether a file that looks the same later holds the same.

    Not one that could not be read, since the reason may lie outside the file, nor one that is recorded or young.
    """
    return not run.fault and run.status != RECORDING and stamp.mtime_ns < read_ns - YOUNG_NS


def stamps_of(directory: Path) -> dict[str, FileStamp]:
    """The run files of a folder as their names sort, each with what it is the same by; none is opened.

    Raises
    ------
    InputError : it is no folder, or cannot be read.
    """
    try:
        with os.scandir(directory) as entries:
            there = {entry.name: _stamp(entry) for entry in entries if is_run_name(entry.name)}
    except NotADirectoryError:
        raise InputError(f"{directory}: not a directory") from None
    except OSError as fault:
        raise InputError(f"{directory}: cannot be read: {fault.strerror}") from fault
    return {name: there[name] for name in sorted(there)}


def _stamp(entry: "os.DirEntry[str]") -> FileStamp:
    try:
        about = entry.stat()
    except OSError:
        return NOT_THERE
    # SQLite's numbers have 63 bits and a sign, inodes of some file systems 64
    return FileStamp(about.st_size, about.st_mtime_ns, about.st_ctime_ns, about.st_ino & (1 << 63) - 1)


def _summaries(directory: Path, names: Sequence[str]) -> list[Summary]:
    from leactl.runfile.catalog.summaries import (
        summary,  # h5py, which takes a tenth of a second, only where a file is opened
    )

    return [summary(directory / name) for name in names]


def list_runs(directory: Path, index: Path | None = None, remark: Tell = silent) -> list[Summary]:
    """Every run file of a folder, oldest first as their names sort, with its tags.

    An index that is there is used and brought up to date.

    Parameters
    ----------
    index : where the index is, if not in the folder.
    remark : is told in a line where the index was not up to date, could not be used or could not be written.

    Raises
    ------
    InputError : no folder, or none of the files that `index` names.
    """
    path = index or directory / NAME
    if os.path.lexists(path):
        catalogue = opened(directory, path, remark)
        was_usable = not catalogue.changed
        catalogue.refresh()
        if was_usable and catalogue.behind:
            remark(f"{path}: was not up to date; {catalogue.read} runs read, {catalogue.gone} gone")
        if catalogue.changed:
            try:
                save(catalogue, path)
            except NotWritten as fault:
                remark(f"{fault}; this list is from the files")
    elif index is not None:
        raise InputError(f"{index}: no such index; leactl runs index {directory} --index {index} makes it")
    else:
        catalogue = Catalogue(directory)
        catalogue.refresh()
        if catalogue.read >= MANY:
            remark(f"{catalogue.read} files opened; leactl runs index {directory} makes the next list quick")
    return with_tags(directory, catalogue.runs, remark)


def update(
    directory: Path, index: Path | None = None, remark: Tell = silent, workers: Workers = HERE, tell: Tell = silent
) -> tuple[Path, Catalogue]:
    """Make the index of a folder, or bring it up to date; a stop keeps what was read until then.

    Parameters
    ----------
    index, remark : as of `list_runs`.
    workers : who reads the runs.
    tell : is told how many runs are read.

    Returns
    -------
    Where the index is, and what it holds.

    Raises
    ------
    InputError : no folder, or one that takes no index; `index` names a file of another kind.
    """
    path = index or directory / NAME
    stamps_of(directory)
    catalogue = opened(directory, path, remark)
    try:
        if not catalogue.rows:  # minutes of reading may follow
            save(catalogue, path)
        try:
            catalogue.refresh(workers, tell)
        finally:
            if catalogue.changed:
                save(catalogue, path)
    except NotWritten as fault:
        raise InputError(f"{fault}; --index FILE puts the index elsewhere") from None
    return path, catalogue


def opened(directory: Path, path: Path, remark: Tell) -> Catalogue:
    """What the index knows of the folder: nothing where there is none, or none that can be used, which is told.

    Raises
    ------
    InputError : the file is of another kind.
    """
    catalogue = Catalogue(directory)
    refuse_other_files(path)
    if os.path.lexists(path):
        try:
            catalogue.rows = read(path, directory)
        except Unusable as reason:
            catalogue.changed = True
            remark(f"{path}: {reason}; made anew from the files")
    return catalogue


def refuse_other_files(path: Path) -> None:
    """Refuse to take the place of a file that is no index, such as one whose name was mistaken for that of the index.

    Raises
    ------
    InputError : it holds something else.
    """
    if path.name == NAME or not os.path.lexists(path):
        return
    head = b""
    with suppress(OSError), open_regular(path) as file:
        head = file.read(APPLICATION_AT.stop)
    if path.is_dir() or (head and not is_index(head)) or not path.is_file():
        raise InputError(f"{path}: is no index of runs and is not replaced; name another file by --index")


def is_index(data: bytes) -> bool:
    """Whether bytes begin as those of an index of any version."""
    return data.startswith(MAGIC) and data[APPLICATION_AT] == APPLICATION.to_bytes(4, "big")


def read(path: Path, directory: Path) -> dict[str, Indexed]:
    """What an index holds.

    Raises
    ------
    Unusable : it is damaged, of another version, or no index.
    """
    try:
        with open_regular(path, MOST_BYTES) as file:
            data = file.read()
    except OSError as fault:
        raise Unusable(f"cannot be read: {fault.strerror}") from None
    if not is_index(data):
        raise Unusable("is no index of runs")
    if (version := int.from_bytes(data[VERSION_AT], "big")) != VERSION:
        raise Unusable(f"is of version {version}, this program's is {VERSION}")
    # from memory: no journal that lies beside the file counts, and no lock is asked for
    with closing(sqlite3.connect(":memory:")) as base:
        try:
            base.deserialize(data)
            base.execute("PRAGMA trusted_schema = OFF")
            if [sql for (sql,) in base.execute("SELECT sql FROM sqlite_schema WHERE sql NOT NULL")] != tables():
                raise Unusable("has other columns than this program's")
            (digest,) = base.execute("SELECT sha256 FROM digest").fetchone()
            if not isinstance(digest, str) or len(digest) != DIGITS or digest_of(data, digest) != digest:
                raise Unusable("is damaged")
            if base.execute(f"SELECT EXISTS (SELECT * FROM runs WHERE {MISTYPED})").fetchone() != (0,):
                raise Unusable("is damaged")
            return rows_of(base.execute("SELECT * FROM runs"), directory)
        except (sqlite3.Error, TypeError, ValueError, RecursionError):
            raise Unusable("is damaged") from None


def rows_of(records: Iterable[tuple[Any, ...]], directory: Path) -> dict[str, Indexed]:
    """Records of the table as rows; parameters that many runs share are one mapping."""
    parameters: dict[str, Mapping[str, Any]] = {}
    rows = {}
    for record in records:
        *known, text, mtime_ns, ctime_ns, inode = record
        if text not in parameters:
            parameters[text] = dict(json.loads(text))
        run = Summary._make([directory, *known, parameters[text], ()])
        if run.fault:
            run = run._replace(fault=f"{run.path}: {run.fault}")
        rows[run.file] = Indexed(FileStamp(run.size, mtime_ns, ctime_ns, inode) if ctime_ns else UNSETTLED, run)
    return rows


def save(catalogue: Catalogue, path: Path) -> None:
    """Write the index as a new file that takes the place of the old one.

    Raises
    ------
    NotWritten : the folder takes no file.
    """
    with closing(sqlite3.connect(":memory:")) as base:
        base.execute(f"PRAGMA application_id = {APPLICATION}")
        base.execute(f"PRAGMA user_version = {VERSION}")
        for table in tables():
            base.execute(table)
        mark = token_hex(DIGITS // 2)
        base.execute("INSERT INTO digest VALUES (?)", (mark,))
        insert = f"INSERT INTO runs VALUES ({', '.join('?' * (len(KNOWN) + len(STAMP)))})"
        for row in catalogue.rows.values():
            # a name that is no UTF-8, or a number beyond 63 bits: SQLite holds neither, and the file is read each time
            with suppress(UnicodeEncodeError, OverflowError):
                base.execute(insert, record_of(row))
        base.commit()
        data = base.serialize()
    with replacement(path) as temporary:
        temporary.write_bytes(data.replace(mark.encode(), digest_of(data, mark).encode()))


def record_of(row: Indexed) -> tuple[Any, ...]:
    """A row as the table has it."""
    # the folder may go by another name next time
    run = row.run._replace(fault=row.run.fault.removeprefix(f"{row.run.path}: "))
    _, *known, parameters, _ = run
    return *known, json.dumps(dict(parameters)), *row.stamp[1:]


def tables() -> list[str]:
    """How the tables are made."""
    columns = ", ".join(f"{name} {TYPES[name]}" for name in (*KNOWN, *STAMP))
    return [f"CREATE TABLE runs ({columns})", "CREATE TABLE digest (sha256 TEXT)"]


def digest_of(data: bytes, stored: str) -> str:
    """SHA-256 of an index with zeros in the place of the digest that is stored in it."""
    return sha256(data.replace(stored.encode(), b"0" * len(stored))).hexdigest()
