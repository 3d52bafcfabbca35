"""Record a run: rows are put into memory at once and written to the disk about once a second.

The live file is uncompressed and in HDF5's single-writer/multiple-reader mode, so that others may read it and a kill
leaves every flushed row readable; an orderly close repacks it. Appending never waits for the disk: `flush` may run in
another thread.
"""

import errno
import os
import shutil
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import h5py
import numpy as np
from h5py import h5s

from leactl.errors import InputError, SafetyTrip, Stopped
from leactl.quantities import ChannelSpec
from leactl.runfile import layout
from leactl.runfile.hdf5.space import reserve, trim
from leactl.runfile.publish import NotWritten, move_without_overwriting, refuse_existing, replacement
from leactl.runfile.summary import CLOSED_STATUSES, RECORDING
from leactl.runfile.write.repack import as_text, one_line, repack, text_bytes
from leactl.runfile.write.row_buffer import RowBuffer
from leactl.runfile.write.run_info import RunInfo, faults_of, new_run_id

__all__ = ["RecordingFailed", "RunInfo", "RunWriter", "new_run_id"]

LIVE_CHUNK_ROWS = 1 << 12  # of a channel in a live file
LIVE_TABLE_ROWS = 16  # rows of a chunk of `/steps` and `/events` in a live file
# chunk cache of each dataset, for its last two chunks; with HDF5 2.0's default of 8 MiB, 20 channels would fill 160 MB
# in the course of a night
LIVE_CACHE_BYTES = 1 << 16
COLUMN_BYTES = 8192  # upper bound of the attributes and index of one dataset


class RecordingFailed(InputError):
    """The run file cannot be written any more; rows that were flushed before stay readable."""


class RunWriter:
    """Writer of one run; use it as a context manager or call `close`.

    `append`, `append_row`, `step` and `event` only touch memory and may be called from the control loop while another
    thread flushes. Rows are recorded once `flush` has returned. `wait_for_disk` is called before each write; an
    emulated bench emulates a slow disk there.
    """

    def __init__(
        self,
        directory: Path,
        info: RunInfo,
        streams: Mapping[str, Sequence[ChannelSpec]],
        wait_for_disk: Callable[[], None] = lambda: None,
    ) -> None:
        if faults := faults_of(info, streams):
            raise InputError(faults)
        self.path = directory / f"{info.run_id}.h5"
        self.closed = False
        self._streams, self._notes = streams, list[str]()
        self._fault = ""  # message of the first failure, repeated by every later call
        self._disk, self._wait_for_disk = threading.Lock(), wait_for_disk
        self._buffers = {name: RowBuffer(len(specs)) for name, specs in streams.items()}
        self._written = dict.fromkeys(streams, 0)
        self._tables: dict[str, list[dict[str, Any]]] = {name: [] for name in layout.TABLES}
        # listener for the rows of a table, by its name
        self.listeners: dict[str, Callable[[Mapping[str, Any]], None]] = {}
        self._tables_written = dict.fromkeys(layout.TABLES, 0)
        partial_path = directory / f"{info.run_id}.h5.partial"
        refuse_existing(self.path)
        refuse_existing(partial_path)
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as fault:
            message = f"{directory}: cannot create the run file: {fault.strerror or fault}; choose another directory"
            raise InputError(message) from None
        try:
            self._file = create(partial_path, info, streams)
            self._datasets = {
                name: opened_columns(self._file["streams"][name], specs) for name, specs in streams.items()
            }
            move_without_overwriting(partial_path, self.path)
        except OSError as fault:
            raise RecordingFailed(f"{partial_path}: cannot create the run file: {one_line(str(fault))}") from fault

    def append_row(self, stream: str, time: float, values: Sequence[float]) -> None:
        """Add one row, in a few microseconds even if the disk is slow."""
        if self.closed:
            raise self._error_after_end()
        self._buffers[stream].append_row(time, values)

    def append(self, stream: str, times: np.ndarray[Any, Any], block: np.ndarray[Any, Any]) -> None:
        """Add rows: `times` (n,) and `block` (n, channels)."""
        if self.closed:
            raise self._error_after_end()
        self._buffers[stream].append(times, block)

    def step(self, name: str, start: float, stop: float, settle: float, parameters: Mapping[str, Any]) -> None:
        """Record a step: its name, times [s] and parameters."""
        times = {"start": float(start), "stop": float(stop), "settle": float(settle)}
        self._add_row("steps", {"name": str(name), **times, "parameters": dict(parameters)})

    def event(self, time: float, level: str, source: str, message: str) -> None:
        """Record an event at a time [s]."""
        row = {"time": float(time), "level": str(level), "source": str(source), "message": str(message)}
        self._add_row("events", row)

    def _add_row(self, table: str, row: dict[str, Any]) -> None:
        """Add a row to a table in memory, and pass it to the table's listener."""
        self._tables[table].append(row)
        if table in self.listeners:
            self.listeners[table](row)

    def flush(self) -> None:
        """Write everything so far to the file, where a reader or a recovery finds it."""
        with self._disk:
            self._on_disk(self._write_pending)
            self._follow_path()

    def notes(self) -> list[str]:
        """Return notes for people about the file since the last call, for example that it was moved."""
        notes, self._notes = self._notes, []
        return notes

    def close(self, status: str, reason: str = "") -> None:
        """Write the remaining rows, repack with compression and checksums, and replace the live file in one step."""
        if status not in CLOSED_STATUSES:
            raise ValueError(f"status {status!r} is none of {', '.join(CLOSED_STATUSES)}")
        with self._disk:
            if self._fault:
                raise self._error_after_end()
            if not self.closed:
                self._on_disk(self._write_pending)
                self._follow_path()
                self._on_disk(self._file.close)
                self._on_disk(lambda: self._repack(status, reason))
                self.closed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if self.closed:
            return
        if error is None:
            self.close("complete")
        else:
            stopped = isinstance(error, Stopped | KeyboardInterrupt)
            status = "tripped" if isinstance(error, SafetyTrip) else "stopped" if stopped else "failed"
            try:
                self.close(status, str(error) or type(error).__name__)
            except RecordingFailed as close_error:  # the reason for the run's end matters more than this error
                error.add_note(str(close_error))

    def _write_pending(self) -> None:
        """Write the rows since the last call to the live file."""
        self._wait_for_disk()
        pending_tables = {name: rows[self._tables_written[name] :] for name, rows in self._tables.items()}
        buffered = {name: buffer.take() for name, buffer in self._buffers.items()}
        self._reserve(buffered, pending_tables)
        for name, rows in buffered.items():
            if len(rows):
                write_rows(self._datasets[name], self._written[name], rows)
                self._written[name] += len(rows)
        for name, pending_rows in pending_tables.items():
            if pending_rows:
                write_live_table(self._file[name], layout.TABLES[name], self._tables_written[name], pending_rows)
                self._tables_written[name] += len(pending_rows)

    def _follow_path(self) -> None:
        """If the file or its folder was removed, moved or replaced, continue in a copy at a path that exists."""
        open_file = os.fstat(self._file.id.get_vfd_handle())
        with suppress(OSError):
            file_at_path = os.lstat(self.path)
            if (file_at_path.st_dev, file_at_path.st_ino) == (open_file.st_dev, open_file.st_ino):
                return
        self._on_disk(self._continue_in_copy)

    def _continue_in_copy(self) -> None:
        """Continue in a copy: in a new folder of the same name, else the working directory, else the temporary one."""
        old_path = self.path
        descriptor = os.dup(self._file.id.get_vfd_handle())
        try:
            self._file.close()
            with os.fdopen(descriptor, "rb", closefd=False) as file:
                folders = [old_path.parent, *working_directory(), Path(tempfile.gettempdir())]
                self.path = copy_to_first(file, old_path.name, folders)
        finally:
            os.close(descriptor)
        self._file = h5py.File(self.path, "r+", libver=layout.HDF5_FORMAT, rdcc_nbytes=LIVE_CACHE_BYTES)
        self._file.swmr_mode = True
        groups = self._file["streams"]
        self._datasets = {name: opened_columns(groups[name], specs) for name, specs in self._streams.items()}
        self._notes.append(
            f"{old_path}: was removed or moved while it was written; every row of the run is in {self.path}"
        )

    def _reserve(self, buffered: Mapping[str, np.ndarray[Any, Any]], tables: Mapping[str, Sequence[Any]]) -> None:
        """Reserve disk space for the rows, one new chunk for each column, and the fixed-length texts of the tables."""
        size = sum(rows.nbytes + 8 * LIVE_CHUNK_ROWS * rows.shape[1] for rows in buffered.values() if len(rows))
        for name, rows in tables.items():
            size += (len(rows) + LIVE_TABLE_ROWS) * sum(width or 8 for width in layout.TABLES[name].values())
        try:
            reserve(self._file, size)
        except OSError:
            self._file.close()  # nothing failed inside HDF5 yet: the file closes in order
            raise

    def _repack(self, status: str, reason: str) -> None:
        """Replace the live file by the compressed one, with status, reason and checksums."""
        trim(self.path)
        with h5py.File(self.path, "r") as live, replacement(self.path) as target:
            repack(live, target, status=status, reason=reason, row_counts=self._written, tables=self._tables)

    def _on_disk(self, action: Callable[[], None]) -> None:
        """Run an action on the file; if it fails, abandon the file and raise RecordingFailed with one line."""
        if self.closed:
            raise self._error_after_end()
        try:
            action()
        # HDF5 reports a full disk as OSError while writing and as RuntimeError while flushing or closing
        except (OSError, RuntimeError, NotWritten) as fault:
            hint = f"{advice_for(fault)}, then run: leactl runs recover"
            self._fault = f"{self.path}: recording failed: {one_line(str(fault))}; {hint}"
            self._abandon()
            raise RecordingFailed(self._fault) from fault

    def _error_after_end(self) -> RecordingFailed:
        """Return the error for a call after the end of the recording."""
        return RecordingFailed(self._fault or f"{self.path}: the recording has ended; start a new run")

    def _abandon(self) -> None:
        """End the recording without closing the file, and keep the file's objects from being collected."""
        self.closed = True
        if self._file:  # closing after a failed write crashes inside HDF5, so that the file stays open
            KEPT_OPEN.append((self._file, self._datasets))


KEPT_OPEN: list[Any] = []  # files that must not be closed before the process ends
ERRNOS_BY_ADVICE = {
    "free space on the disk": (errno.ENOSPC, errno.EDQUOT, errno.EFBIG),
    "raise the limit of open files (ulimit -n)": (errno.EMFILE, errno.ENFILE),
    "let this user write there, or choose --out": (errno.EACCES, errno.EPERM, errno.EROFS),
    "make the folder again, or choose --out": (errno.ENOENT, errno.ENOTDIR, errno.ESTALE),
    "end other programs, for memory is short": (errno.ENOMEM,),
}


def advice_for(fault: BaseException) -> str:
    """Return the advice for a failed write by its errno; an error of HDF5 without errno is taken for a full disk."""
    error_number = getattr(fault, "errno", None)
    return next(
        (advice for advice, error_numbers in ERRNOS_BY_ADVICE.items() if error_number in error_numbers),
        "free space on the disk",
    )


def working_directory() -> list[Path]:
    """Return the working directory in a list; empty if it no longer exists."""
    try:
        return [Path.cwd()]
    except OSError:
        return []


def copy_to_first(file: BinaryIO, name: str, folders: Sequence[Path]) -> Path:
    """Copy a file into the first folder in which it can be created; nothing is overwritten.

    Raises
    ------
    OSError : the file can be created in none of the folders.
    """
    last_error = OSError("there is no folder for it")
    for folder in folders:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with (folder / name).open("xb") as copy:
                file.seek(0)
                shutil.copyfileobj(file, copy)
                os.fsync(copy.fileno())
        except OSError as error:
            last_error = error
        else:
            return folder / name
    raise last_error


def create(partial_path: Path, info: RunInfo, streams: Mapping[str, Sequence[ChannelSpec]]) -> Any:
    """Create all groups and datasets of a run, since SWMR mode allows no new ones, and switch SWMR on."""
    file = h5py.File(partial_path, "x", libver=layout.HDF5_FORMAT, rdcc_nbytes=LIVE_CACHE_BYTES)
    try:
        columns = sum(1 + len(specs) for specs in streams.values())
        reserve(file, columns * COLUMN_BYTES + sum(text_bytes(text) for text in info.sources.values()))
    except OSError:
        file.close()
        partial_path.unlink()
        raise
    for name in layout.ROOT_ATTRIBUTES:
        file.attrs[name] = layout.storable(value) if isinstance(value := root_value(name, info), str) else value
    if info.seed is not None:
        file.attrs["seed"] = info.seed
    setup = file.create_group("setup")
    setup.attrs["mechanical"] = info.mechanical
    for name, value in info.setup.items():
        setup.attrs[name] = value
    layout.describe(file, info.parameters, info.instruments)
    for name, text in info.sources.items():
        file.create_dataset(f"{name}/source", data=text, dtype=layout.TEXT)
    stream_group = file.create_group("streams")
    # a stamp that was announced and never written is read as the fill value, NaN, and its row is cut
    live_storage = {"shape": (0,), "maxshape": (None,), "chunks": (LIVE_CHUNK_ROWS,), "fillvalue": np.nan}
    for stream, specs in streams.items():
        layout.create_stream(stream_group, stream, list(specs), **live_storage)
    for table, widths in layout.TABLES.items():
        for column, width in widths.items():
            dtype = "<f8" if width is None else h5py.string_dtype("utf-8", width)
            file.create_dataset(f"{table}/{column}", (0,), dtype=dtype, maxshape=(None,), chunks=(LIVE_TABLE_ROWS,))
    file.swmr_mode = True
    return file


def root_value(name: str, info: RunInfo) -> Any:
    """Return the value of a root attribute at the start of the recording."""
    initial_values: dict[str, Any] = {
        "format": layout.FORMAT,
        "format_version": layout.VERSION,
        "status": RECORDING,
        "status_reason": "",
        "simulated": int(info.simulated),
    }
    return initial_values[name] if name in initial_values else getattr(info, name)


def opened_columns(stream: Any, specs: Sequence[ChannelSpec]) -> list[tuple[int, Any, np.dtype[Any]]]:
    """Return (column in a row, dataset, type) of a stream's datasets in the order of writing: channels before time.

    Since the stamp is written last, a stamp in the file means that its whole row is in the file.
    """
    indices = {spec.name: index for index, spec in enumerate(specs, start=1)} | {"time": 0}
    return [(index, stream[name].id, stream[name].dtype) for name, index in indices.items()]


def write_rows(
    columns: Sequence[tuple[int, Any, np.dtype[Any]]], written_rows: int, rows: np.ndarray[Any, Any]
) -> None:
    """Append rows by HDF5's low-level calls: h5py's slices take three times as long for short blocks."""
    memory_space, file_space = h5s.create_simple((len(rows),)), h5s.create_simple((written_rows + len(rows),))
    file_space.select_hyperslab((written_rows,), (len(rows),))  # one for all columns, which have equal lengths
    with np.errstate(over="ignore"):  # a value beyond the range of float32 becomes infinite
        for index, dataset, dtype in columns:
            extend(dataset, written_rows + len(rows))
            dataset.write(memory_space, file_space, np.ascontiguousarray(rows[:, index], dtype))
            dataset.flush()


def write_live_table(
    group: Any, columns: Mapping[str, int | None], written_rows: int, rows: Sequence[Mapping[str, Any]]
) -> None:
    """Append to `/steps` or `/events`; texts are cut to the fixed length of the column."""
    for column, width in columns.items():
        dataset = group[column]
        extend(dataset.id, written_rows + len(rows))
        values = [row[column] if width is None else cut_to_width(row[column], width) for row in rows]
        dataset[written_rows : written_rows + len(rows)] = np.array(values, dataset.dtype)
        dataset.flush()


def extend(dataset: Any, rows: int) -> None:
    """Extend a dataset to `rows` rows; after an interrupted flush it may be longer, and SWMR forbids to shrink it."""
    if dataset.shape[0] < rows:
        dataset.set_extent((rows,))


def cut_to_width(value: Any, width: int) -> bytes:
    """Encode a text in at most `width` bytes; parameters lose whole entries from the end and stay valid JSON."""
    if isinstance(value, Mapping):
        kept_entries = dict(value)
        while len(encoded := layout.storable(as_text(kept_entries)).encode()) > width:
            kept_entries.popitem()
        return encoded
    return layout.storable(value).encode()[:width].decode("utf-8", "ignore").encode()
