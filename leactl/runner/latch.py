"""Trip latches: files in which a tripped bench stays latched until a person resets it.

A bench on real buses latches for the machine, by its name. A bench that is emulated in the process of its run latches
by its bench file, so that a tripped rehearsal does not hold another one. A latch in any state folder holds the bench.
"""

import errno
import json
import os
import secrets
import shlex
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, astuple, dataclass
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from leactl.bench import benchfile
from leactl.bench.benchfile import BenchFile
from leactl.errors import InputError, LeactlError, SafetyTrip
from leactl.regular_files import read_at, write_at
from leactl.runfile.publish import force_to_disk
from leactl.runner import runs_underway, state_folder
from leactl.runner.runs_underway import LostRun
from leactl.yamlfile import printable

SUFFIX = ".trip.json"
RELEASED = b'{"released": true}\n'  # content of a file that holds no bench: held ready, or another user's to remove
LATCH_BYTES = 4096  # of a latch that is held ready, so that setting it takes no disk space
DIGEST_DIGITS = 16  # of a file's digest in the name of its latch


@dataclass(frozen=True)
class Trip:
    """Cause and time of a trip, and the recording of its run."""

    bench: str
    cause: str
    time: str  # ISO 8601, UTC
    run: str


@dataclass(frozen=True)
class Latch:
    """The latch of one bench."""

    bench: str  # its name
    resets: str  # argument of `leactl bench reset` for it
    paths: tuple[str, ...]  # the first is written; a file at any of them holds the bench
    shared: bool = False  # whether the first is writable for every user

    def set(self, cause: str, run: Path) -> None:
        """Latch the bench, on the disk before this returns; a write that is cut short latches it too, cause unknown.

        Raises
        ------
        LeactlError : the latch could not be written; the bench is safe, but the next run will not know.
        """
        path = Path(self.paths[0])
        try:
            descriptor = state_folder.open_file(path, self.shared)
            try:
                text = _content(self.bench, cause, run)
                if write_at(descriptor, text, 0) < len(
                    text
                ):  # overwrites an earlier cause, which a full disk leaves intact
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.ftruncate(descriptor, len(text))
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
            force_to_disk(path.parent)
        except OSError as error:
            raise LeactlError(f"{path}: the trip could not be latched: {error.strerror or error}") from None

    def trip(self) -> Trip | None:
        """Return the trip that holds this bench, or None; a latch that cannot be read holds the bench too."""
        trips = (_trip(self.bench, Path(path)) for path in self.paths)
        return next((trip for trip in trips if trip is not None), None)

    def refuse(self) -> None:
        """Raise SafetyTrip if the bench is tripped.

        Raises
        ------
        SafetyTrip : the bench is tripped, with the cause and the command that resets it.
        """
        trip = self.trip()
        if trip is not None:
            raise SafetyTrip(
                f"bench '{self.bench}' is tripped since {trip.time}: {trip.cause};"
                f" see: leactl bench reset {shlex.quote(self.resets)}"
            )

    def release(self) -> None:
        """Remove the latch, whichever user made it.

        Raises
        ------
        InputError : this user may not write to it.
        """
        for path in map(Path, self.paths):
            if _trip(self.bench, path) is None:
                continue
            with suppress(OSError):
                path.unlink()
                continue
            with suppress(OSError):  # a folder, with any content
                path.rename(path.with_name(f"{path.name}.{secrets.token_hex(4)}.aside"))
                continue
            try:  # a file of another user in a sticky directory
                descriptor = state_folder.open_file(path, self.shared)
                try:
                    os.ftruncate(descriptor, 0)
                    os.write(descriptor, RELEASED)
                finally:
                    os.close(descriptor)
            except OSError as error:
                reason = error.strerror or error
                raise InputError(
                    f"{path}: the latch cannot be released: {reason}; its owner may, as root may"
                ) from None


class UnlatchedRun(NamedTuple):
    """A lost run that holds its bench by its run file, and the fault that kept its latch from being written."""

    lost: LostRun
    fault: str


class OpenLatch:
    """A latch whose file is open and of full size before the first move: setting it needs no descriptor or disk space.

    Until then the file says that the latch is released. If the file was removed or exchanged, `set` makes a new one.
    """

    def __init__(self, latch: Latch) -> None:
        """Open the file of the latch, or make it.

        Raises
        ------
        LeactlError : the file can be neither opened nor made.
        """
        self._latch, self._path = latch, Path(latch.paths[0])
        self._cut_short = json.dumps(asdict(Trip(latch.bench, "unknown, for want of memory", "", ""))).encode()
        try:
            self._descriptor = state_folder.open_file(self._path, latch.shared)
            if read_at(self._descriptor, LATCH_BYTES, 0).strip() in (b"", RELEASED.strip()):
                self._write(RELEASED)
                force_to_disk(self._path.parent)
        except OSError as error:
            raise LeactlError(f"{self._path}: no trip could be latched: {error.strerror or error}") from None

    def set(self, cause: str, run: Path) -> None:
        """Latch the bench, on the disk before this returns; as `Latch.set`.

        Raises
        ------
        LeactlError : the latch could not be written; the bench is safe, but the next run will not know.
        """
        try:
            text = _content(self._latch.bench, cause, run)
        except MemoryError:
            text = self._cut_short
        if not state_folder.is_at_path(self._descriptor, self._path):
            self._latch.set(cause, run)
            return
        try:
            self._write(text)
        except OSError as error:
            raise LeactlError(f"{self._path}: the trip could not be latched: {error.strerror or error}") from None

    def close(self) -> None:
        """Close the file, and remove it if the latch was not set."""
        with suppress(OSError):
            if (
                state_folder.is_at_path(self._descriptor, self._path)
                and read_at(self._descriptor, LATCH_BYTES, 0).strip() == RELEASED.strip()
            ):
                self._path.unlink()
        os.close(self._descriptor)

    def _write(self, text: bytes) -> None:
        """Write the content of the latch, on the disk before this returns.

        Raises
        ------
        OSError : it could not be written whole.
        """
        if write_at(self._descriptor, text.ljust(LATCH_BYTES), 0) < len(text):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync(self._descriptor)


def _content(bench: str, cause: str, run: Path) -> bytes:
    """Return the content of a latch that is set now."""
    trip = Trip(bench, cause, datetime.now(UTC).isoformat(timespec="seconds"), str(run))
    return json.dumps(asdict(trip), indent=1).encode() + b"\n"


def of(bench: BenchFile, file: str, in_process: bool) -> Latch:
    """Return the latch of a bench for its run; `file` is the path of the bench file."""
    if in_process:
        return _of_file(bench.name, Path(file))
    state = state_folder.folder_of(bench, in_process)
    directories = dict.fromkeys([state.directory, *(folder.directory for folder in state_folder.folders())])
    paths = tuple(str(directory / f"{bench.name}{SUFFIX}") for directory in directories)
    return Latch(bench.name, bench.name, paths, state.shared)


def latches_named(word: str) -> list[Latch]:
    """Return every latch for a bench's name, as a trip reports it, or for the path of a bench file."""
    if Path(word).suffix not in (".yaml", ".yml"):
        return list(_by_name(word))
    file, _devices, document = benchfile.load(word)
    return [*_by_name(file.name, of_files=False), _of_file(file.name, Path(document.name))]


def tripped_latches(word: str) -> dict[Latch, Trip]:
    """Return the latches of `latches_named` that hold a bench, each with its trip."""
    trips = {latch: latch.trip() for latch in latches_named(word)}
    return {latch: trip for latch, trip in trips.items() if trip is not None}


def latch_lost_runs(bench: str) -> list[UnlatchedRun]:
    """Latch a bench on real buses for each of its lost runs, whose devices may be in any state.

    A latch that is already set gets the cause in addition, so that whoever resets it reads both causes; a latch that
    names the same process was set by its watchdog, and stays. Return the runs whose latch could not be written, or
    whose file could be neither removed nor marked: that file holds the bench until a reset.
    """
    unlatched = []
    for run in runs_underway.lost(bench):
        latch = Latch(bench, bench, (str(run.folder.directory / f"{bench}{SUFFIX}"),), run.folder.shared)
        trip = latch.trip()
        try:
            if trip is None or f"process {run.process} " not in trip.cause:
                latch.set(f"{trip.cause}; {run.cause}" if trip else run.cause, Path(run.recording))
            runs_underway.forget(run)
        except LeactlError as error:
            unlatched.append(UnlatchedRun(run, str(error)))
    return unlatched


def refuse_lost_runs(bench: str) -> None:
    """Latch a bench for its lost runs; raise SafetyTrip if a latch could not be written.

    Raises
    ------
    SafetyTrip : a latch could not be written; with the cause, the fault, and the command that resets the bench.
    """
    for run in latch_lost_runs(bench):
        raise SafetyTrip(
            f"bench '{bench}' is tripped: {run.lost.cause}; {run.fault}; see: leactl bench reset {shlex.quote(bench)}"
        )


def _of_file(bench: str, file: Path) -> Latch:
    """Return the latch of a bench emulated here, by the resolved path of its file, in the user's state folder."""
    path = file.resolve()
    resets = path.stem if path.parent == benchfile.SHIPPED.resolve() else str(path)
    digest = sha256(os.fsencode(path)).hexdigest()[:DIGEST_DIGITS]
    return Latch(bench, resets, (str(state_folder.state_directory() / f"{bench}@{digest}{SUFFIX}"),))


def _by_name(bench: str, of_files: bool = True) -> Iterator[Latch]:
    """Yield the latches in all state folders for benches of this name, which has no `@`."""
    for folder in state_folder.folders():
        with suppress(OSError):
            for path in sorted(folder.directory.iterdir()):
                key, suffix, remainder = path.name.partition(SUFFIX)
                if suffix and not remainder and (key == bench or (of_files and key.partition("@")[0] == bench)):
                    yield Latch(bench, bench, (str(path),), folder.shared)


def _trip(bench: str, path: Path) -> Trip | None:
    """Return the trip in a latch file; None if there is no file or it is released."""
    try:
        text = state_folder.read(path)
    except FileNotFoundError:
        return None
    except OSError as error:
        return Trip(bench, f"unknown, {path} cannot be read: {error.strerror or error}", "", "")
    if text.strip() == RELEASED.strip():
        return None
    try:
        texts = astuple(Trip(**json.loads(text)))
    except (ValueError, TypeError, RecursionError) as error:
        return Trip(bench, f"unknown, {path} cannot be read: {error}", "", "")
    if not all(isinstance(value, str) for value in texts):
        return Trip(bench, f"unknown, {path} cannot be read: texts were expected", "", "")
    return Trip(*map(printable, texts))  # one line each, whatever the file contains
