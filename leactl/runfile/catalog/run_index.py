"""Index the runs of a folder: store the summaries of its files, so that unchanged files are not opened again.

The index is a SQLite file and can be rebuilt from the run files at any time. A row is valid only if the size, times
and inode of its file have not changed since it was read. The whole index is read into memory and written as a new
file that replaces the old one, so that no locks are needed: of two writers at the same time the later one remains.
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
from leactl.regular_files import open_regular
from leactl.runfile.catalog.tags import with_tags
from leactl.runfile.publish import NotWritten, replacement
from leactl.runfile.summary import RECORDING, Summary, is_run_name

NAME: Final = ".leactl-index.sqlite"
APPLICATION: Final = 0x6C656178  # "leax"
VERSION: Final = 1  # increases if the meaning of a column changes
# SQLite file format, 1.3: the file's first bytes, the user version and the application identifier
MAGIC, VERSION_AT, APPLICATION_AT = b"SQLite format 3\0", slice(60, 64), slice(68, 72)
MOST_INDEX_BYTES: Final = 1 << 30  # of an index: some million runs
# a file that was read within this time after a change may change again without a new time of change, since the file
# system's clock may advance in steps of up to 2 s (FAT)
YOUNG_NS: Final = 2 * 10**9
DIGEST_DIGITS: Final = 64  # of a SHA-256
BATCH_FILES: Final = 32  # files of one job, which takes about 0.2 s
PROGRESS_INTERVAL: Final = 10 * BATCH_FILES  # runs from one line of progress to the next
MANY_FILES: Final = 1000  # number of files that takes some seconds to open

INDEXED_FIELDS: Final = Summary._fields[1:-1]  # all but the folder and the tags
STAMP_COLUMNS: Final = ("mtime_ns", "ctime_ns", "inode")
TYPES: Final = {
    **{name: {float: "REAL", int: "INTEGER"}.get(kind, "TEXT") for name, kind in get_type_hints(Summary).items()},
    **dict.fromkeys(("seed", *STAMP_COLUMNS), "INTEGER"),
}
# condition for a row with a value of a wrong type, since SQLite accepts any type in any column
HAS_WRONG_TYPE: Final = " OR ".join(
    f"typeof({name}) NOT IN ('{TYPES[name].lower()}'{', ' + repr('null') if name == 'seed' else ''})"
    for name in (*INDEXED_FIELDS, *STAMP_COLUMNS)
)

Tell = Callable[[str], None]


def ignore(line: str) -> None:
    """Discard a line; the default where nobody reads progress or remarks."""


class FileStamp(NamedTuple):
    """File status by which an unchanged file is recognised."""

    size: int
    mtime_ns: int
    ctime_ns: int
    inode: int


UNSETTLED: Final = FileStamp(0, 0, 0, 0)  # status of a file that has to be read again next time
NOT_THERE: Final = FileStamp(-1, -1, -1, -1)  # status of a link without target


class IndexedRun(NamedTuple):
    """A run of the index, and the status of its file when it was read."""

    stamp: FileStamp
    run: Summary


class UnusableIndex(Exception):
    """The index file cannot be used and has to be built again; the message says why."""


@dataclass
class Catalogue:
    """The runs of a folder, with counts of the files that were opened or are gone."""

    directory: Path
    rows: dict[str, IndexedRun] = field(default_factory=dict)  # by file name, sorted
    read: int = 0  # number of files that were opened
    gone: int = 0  # number of files of the index that no longer exist
    changed: bool = False  # whether the index has to be written
    behind: bool = False  # whether the runs differ from those of the index

    @property
    def runs(self) -> list[Summary]:
        """Runs sorted by file name, which puts the oldest first."""
        return [row.run for row in self.rows.values()]

    def refresh(self, workers: Workers = HERE, tell: Tell = ignore) -> None:
        """Read new and changed files, and drop files that no longer exist.

        If the reading is interrupted, the summaries read so far are kept.

        Parameters
        ----------
        workers : processes that open the files.
        tell : called with a line of progress.

        Raises
        ------
        InputError : the folder cannot be read.
        """
        known_rows, stamps = self.rows, stamps_of(self.directory)
        self.gone = len(known_rows.keys() - stamps.keys())
        names_to_read = [
            name for name, stamp in stamps.items() if name not in known_rows or known_rows[name].stamp != stamp
        ]
        self.rows = {name: known_rows[name] for name in stamps.keys() - names_to_read}
        start_ns = time.time_ns()
        batches = [names_to_read[first : first + BATCH_FILES] for first in range(0, len(names_to_read), BATCH_FILES)]
        jobs = [(self.directory, batch) for batch in batches]
        try:
            for outcome in workers.in_order(_summaries, jobs):
                for run in outcome.value():
                    stamp = stamps[run.file] if is_settled(run, stamps[run.file], start_ns) else UNSETTLED
                    self.rows[run.file] = IndexedRun(stamp, run)
                    self.read += 1
                if self.read % PROGRESS_INTERVAL == 0:
                    tell(f"{self.read} of {len(names_to_read)} files read")
        finally:
            self.rows = {name: self.rows[name] for name in stamps if name in self.rows}
            self.changed = self.changed or self.rows != known_rows
            if self.changed:
                self.behind = {name: row.run for name, row in known_rows.items()} != {
                    run.file: run for run in self.runs
                }


def is_settled(run: Summary, stamp: FileStamp, read_start_ns: int) -> bool:
    """Return whether an unchanged file status will mean unchanged content.

    It does not for an unreadable file, since the reason may be outside the file, nor for a file that is still being
    recorded or that was changed just before it was read.
    """
    return not run.fault and run.status != RECORDING and stamp.mtime_ns < read_start_ns - YOUNG_NS


def stamps_of(directory: Path) -> dict[str, FileStamp]:
    """Return the file status of each run file of a folder, sorted by name, without opening a file.

    Raises
    ------
    InputError : not a folder, or it cannot be read.
    """
    try:
        with os.scandir(directory) as entries:
            stamps = {entry.name: _file_stamp(entry) for entry in entries if is_run_name(entry.name)}
    except NotADirectoryError:
        raise InputError(f"{directory}: not a directory") from None
    except OSError as fault:
        raise InputError(f"{directory}: cannot be read: {fault.strerror}") from fault
    return {name: stamps[name] for name in sorted(stamps)}


def _file_stamp(entry: "os.DirEntry[str]") -> FileStamp:
    """Return the status of a file; `NOT_THERE` for a link without target."""
    try:
        status = entry.stat()
    except OSError:
        return NOT_THERE
    # SQLite's integers have 63 bits and a sign, the inodes of some file systems 64 bits
    return FileStamp(status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino & (1 << 63) - 1)


def _summaries(directory: Path, names: Sequence[str]) -> list[Summary]:
    """Return the summaries of files of a folder, without tags."""
    from leactl.runfile.catalog.summaries import (
        summary,  # h5py, which takes a tenth of a second, only where a file is opened
    )

    return [summary(directory / name) for name in names]


def list_runs(directory: Path, index: Path | None = None, remark: Tell = ignore) -> list[Summary]:
    """Return the summaries of all run files of a folder with their tags, sorted by file name.

    An existing index is used and brought up to date.

    Parameters
    ----------
    index : path of the index, if it is not in the folder.
    remark : called with a line if the index was out of date, unusable or could not be written.

    Raises
    ------
    InputError : no such folder, or no file at `index`.
    """
    path = index or directory / NAME
    if os.path.lexists(path):
        catalogue = load_catalogue(directory, path, remark)
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
        if catalogue.read >= MANY_FILES:
            remark(f"{catalogue.read} files opened; leactl runs index {directory} makes the next list quick")
    return with_tags(directory, catalogue.runs, remark)


def update(
    directory: Path, index: Path | None = None, remark: Tell = ignore, workers: Workers = HERE, tell: Tell = ignore
) -> tuple[Path, Catalogue]:
    """Create the index of a folder or bring it up to date; an interrupt keeps what was read so far.

    Parameters
    ----------
    index, remark : as of `list_runs`.
    workers : processes that read the runs.
    tell : called with a line of progress.

    Returns
    -------
    Path of the index, and its content.

    Raises
    ------
    InputError : no such folder, a folder that cannot be written, or `index` names a file that is no index.
    """
    path = index or directory / NAME
    stamps_of(directory)
    catalogue = load_catalogue(directory, path, remark)
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


def load_catalogue(directory: Path, path: Path, remark: Tell) -> Catalogue:
    """Load the index of a folder; empty if there is none, or if it is unusable, with the reason as a remark.

    Raises
    ------
    InputError : the file is not an index of runs.
    """
    catalogue = Catalogue(directory)
    refuse_foreign_file(path)
    if os.path.lexists(path):
        try:
            catalogue.rows = read(path, directory)
        except UnusableIndex as reason:
            catalogue.changed = True
            remark(f"{path}: {reason}; made anew from the files")
    return catalogue


def refuse_foreign_file(path: Path) -> None:
    """Raise InputError if a path that is to be the index is that of another file, for example by mistake.

    Raises
    ------
    InputError : the file exists and is not an index.
    """
    if path.name == NAME or not os.path.lexists(path):
        return
    first_bytes = b""
    with suppress(OSError), open_regular(path) as file:
        first_bytes = file.read(APPLICATION_AT.stop)
    if path.is_dir() or (first_bytes and not is_index(first_bytes)) or not path.is_file():
        raise InputError(f"{path}: is no index of runs and is not replaced; name another file by --index")


def is_index(data: bytes) -> bool:
    """Return whether bytes begin like an index of any version."""
    return data.startswith(MAGIC) and data[APPLICATION_AT] == APPLICATION.to_bytes(4, "big")


def read(path: Path, directory: Path) -> dict[str, IndexedRun]:
    """Read the rows of an index.

    Raises
    ------
    UnusableIndex : the file is damaged, of another version, or not an index.
    """
    try:
        with open_regular(path, MOST_INDEX_BYTES) as file:
            data = file.read()
    except OSError as fault:
        raise UnusableIndex(f"cannot be read: {fault.strerror}") from None
    if not is_index(data):
        raise UnusableIndex("is no index of runs")
    if (version := int.from_bytes(data[VERSION_AT], "big")) != VERSION:
        raise UnusableIndex(f"is of version {version}, this program's is {VERSION}")
    # from memory, so that SQLite neither reads a journal in the same folder nor locks the file
    with closing(sqlite3.connect(":memory:")) as database:
        try:
            database.deserialize(data)
            database.execute("PRAGMA trusted_schema = OFF")
            if [sql for (sql,) in database.execute("SELECT sql FROM sqlite_schema WHERE sql NOT NULL")] != tables():
                raise UnusableIndex("has other columns than this program's")
            (digest,) = database.execute("SELECT sha256 FROM digest").fetchone()
            if not isinstance(digest, str) or len(digest) != DIGEST_DIGITS or digest_of(data, digest) != digest:
                raise UnusableIndex("is damaged")
            if database.execute(f"SELECT EXISTS (SELECT * FROM runs WHERE {HAS_WRONG_TYPE})").fetchone() != (0,):
                raise UnusableIndex("is damaged")
            return rows_of(database.execute("SELECT * FROM runs"), directory)
        except (sqlite3.Error, TypeError, ValueError, RecursionError):
            raise UnusableIndex("is damaged") from None


def rows_of(records: Iterable[tuple[Any, ...]], directory: Path) -> dict[str, IndexedRun]:
    """Convert records of the table to rows by file name; equal parameters of several runs become one mapping object."""
    parameters: dict[str, Mapping[str, Any]] = {}
    rows = {}
    for record in records:
        *field_values, parameters_text, mtime_ns, ctime_ns, inode = record
        if parameters_text not in parameters:
            parameters[parameters_text] = dict(json.loads(parameters_text))
        run = Summary._make([directory, *field_values, parameters[parameters_text], ()])
        if run.fault:
            run = run._replace(fault=f"{run.path}: {run.fault}")
        rows[run.file] = IndexedRun(FileStamp(run.size, mtime_ns, ctime_ns, inode) if ctime_ns else UNSETTLED, run)
    return rows


def save(catalogue: Catalogue, path: Path) -> None:
    """Write the index to a new file that replaces the old one.

    Raises
    ------
    NotWritten : the file cannot be written.
    """
    with closing(sqlite3.connect(":memory:")) as database:
        database.execute(f"PRAGMA application_id = {APPLICATION}")
        database.execute(f"PRAGMA user_version = {VERSION}")
        for table in tables():
            database.execute(table)
        placeholder = token_hex(DIGEST_DIGITS // 2)
        database.execute("INSERT INTO digest VALUES (?)", (placeholder,))
        insert = f"INSERT INTO runs VALUES ({', '.join('?' * (len(INDEXED_FIELDS) + len(STAMP_COLUMNS)))})"
        for row in catalogue.rows.values():
            # SQLite stores neither names that are not UTF-8 nor numbers beyond 63 bits: such files are read each time
            with suppress(UnicodeEncodeError, OverflowError):
                database.execute(insert, record_of(row))
        database.commit()
        data = database.serialize()
    with replacement(path) as temporary:
        temporary.write_bytes(data.replace(placeholder.encode(), digest_of(data, placeholder).encode()))


def record_of(row: IndexedRun) -> tuple[Any, ...]:
    """Convert a row to a record of the SQLite table."""
    # without the path, since the folder may have been moved when the index is read
    run = row.run._replace(fault=row.run.fault.removeprefix(f"{row.run.path}: "))
    _, *field_values, parameters, _ = run
    return *field_values, json.dumps(dict(parameters)), *row.stamp[1:]


def tables() -> list[str]:
    """Return the SQL statements that create the tables."""
    columns = ", ".join(f"{name} {TYPES[name]}" for name in (*INDEXED_FIELDS, *STAMP_COLUMNS))
    return [f"CREATE TABLE runs ({columns})", "CREATE TABLE digest (sha256 TEXT)"]


def digest_of(data: bytes, stored: str) -> str:
    """Return the SHA-256 of an index in which the stored digest is replaced by zeros."""
    return sha256(data.replace(stored.encode(), b"0" * len(stored))).hexdigest()
