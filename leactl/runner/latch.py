"""A trip outlives its process: the bench stays latched in a file until a person resets it.

A bench on real buses latches for the machine, by its name; one that is emulated in its run's process by its file, so
that no tripped rehearsal holds another one. A latch in any place where one may lie holds the bench.
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
RELEASED = b'{"released": true}\n'  # in the file of another user, whom it takes to remove it
BYTES = 4096  # of a latch that is held ready, so that setting it takes no room
DIGITS = 16  # of a file's digest in the name of its latch


@dataclass(frozen=True)
class Trip:
    """Why and when a bench was tripped, and the run that shows it."""

    bench: str
    cause: str
    time: str  # ISO 8601, UTC
    run: str


@dataclass(frozen=True)
class Latch:
    """The latch of one bench."""

    bench: str  # its name
    resets: str  # what `leactl bench reset` takes for it
    paths: tuple[str, ...]  # the first is written; a file at any of them holds the bench
    shared: bool = False  # the first is every user's

    def set(self, cause: str, run: Path) -> None:
        """Latch the bench, on the disk when this returns; a write that is cut short latches it too, cause unknown.

        Raises
        ------
        LeactlError : the latch could not be written; the bench is safe, but the next run will not know.
        """
        path = Path(self.paths[0])
        try:
            descriptor = state_folder.opened(path, self.shared)
            try:
                text = _told(self.bench, cause, run)
                if write_at(descriptor, text, 0) < len(text):  # over an earlier cause, which a full disk leaves whole
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.ftruncate(descriptor, len(text))
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
            force_to_disk(path.parent)
        except OSError as error:
            raise LeactlError(f"{path}: the trip could not be latched: {error.strerror or error}") from None

    def trip(self) -> Trip | None:
        """The trip that holds this bench, or None; a latch that cannot be read holds it too."""
        trips = (_trip(self.bench, Path(path)) for path in self.paths)
        return next((trip for trip in trips if trip is not None), None)

    def refuse(self) -> None:
        """Refuse to move a tripped bench.

        Raises
        ------
        SafetyTrip : with the cause and the command that resets it.
        """
        trip = self.trip()
        if trip is not None:
            raise SafetyTrip(
                f"bench '{self.bench}' is tripped since {trip.time}: {trip.cause};"
                f" see: leactl bench reset {shlex.quote(self.resets)}"
            )

    def release(self) -> None:
        """Take the latch away, whoever made it.

        Raises
        ------
        InputError : this user may not.
        """
        for path in map(Path, self.paths):
            if _trip(self.bench, path) is None:
                continue
            with suppress(OSError):
                path.unlink()
                continue
            with suppress(OSError):  # a folder, whatever is in it
                path.rename(path.with_name(f"{path.name}.{secrets.token_hex(4)}.aside"))
                continue
            try:  # another user's in a sticky directory
                descriptor = state_folder.opened(path, self.shared)
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
    """A lost run that holds its bench by its own file, and what could not be written."""

    lost: LostRun
    fault: str


class Ready:
    """A latch whose file is open before the first move, with its room: to set it takes no descriptor and no disk space.

    Until it is set it says that it is released. Where its file was removed or exchanged meanwhile, it is made anew.
    """

    def __init__(self, latch: Latch) -> None:
        """Open it, or make it.

        Raises
        ------
        LeactlError : it cannot be.
        """
        self._latch, self._path = latch, Path(latch.paths[0])
        self._cut_short = json.dumps(asdict(Trip(latch.bench, "unknown, for want of memory", "", ""))).encode()
        try:
            self._descriptor = state_folder.opened(self._path, latch.shared)
            if read_at(self._descriptor, BYTES, 0).strip() in (b"", RELEASED.strip()):
                self._write(RELEASED)
                force_to_disk(self._path.parent)
        except OSError as error:
            raise LeactlError(f"{self._path}: no trip could be latched: {error.strerror or error}") from None

    def set(self, cause: str, run: Path) -> None:
        """Latch the bench, on the disk when this returns; as `Latch.set`.

        Raises
        ------
        LeactlError : the latch could not be written; the bench is safe, but the next run will not know.
        """
        try:
            text = _told(self._latch.bench, cause, run)
        except MemoryError:
            text = self._cut_short
        if not state_folder.in_place(self._descriptor, self._path):
            self._latch.set(cause, run)
            return
        try:
            self._write(text)
        except OSError as error:
            raise LeactlError(f"{self._path}: the trip could not be latched: {error.strerror or error}") from None

    def close(self) -> None:
        """Let it go, and take it away where it was not set."""
        with suppress(OSError):
            if (
                state_folder.in_place(self._descriptor, self._path)
                and read_at(self._descriptor, BYTES, 0).strip() == RELEASED.strip()
            ):
                self._path.unlink()
        os.close(self._descriptor)

    def _write(self, text: bytes) -> None:
        if write_at(self._descriptor, text.ljust(BYTES), 0) < len(text):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync(self._descriptor)


def _told(bench: str, cause: str, run: Path) -> bytes:
    trip = Trip(bench, cause, datetime.now(UTC).isoformat(timespec="seconds"), str(run))
    return json.dumps(asdict(trip), indent=1).encode() + b"\n"


def of(bench: BenchFile, file: str, in_process: bool) -> Latch:
    """The latch of a bench as its run meets it; `file` is where its bench file lies."""
    if in_process:
        return _of_file(bench.name, Path(file))
    place = state_folder.place_of(bench, in_process)
    directories = dict.fromkeys([place.directory, *(other.directory for other in state_folder.places())])
    paths = tuple(str(directory / f"{bench.name}{SUFFIX}") for directory in directories)
    return Latch(bench.name, bench.name, paths, place.shared)


def named(word: str) -> list[Latch]:
    """Every latch that a word leads to: a bench's name, as a trip tells it, or a path to a bench file."""
    if Path(word).suffix not in (".yaml", ".yml"):
        return list(_by_name(word))
    file, _devices, document = benchfile.load(word)
    return [*_by_name(file.name, of_files=False), _of_file(file.name, Path(document.name))]


def tripped(word: str) -> dict[Latch, Trip]:
    """Those of the latches `named` that hold a bench, and why."""
    trips = {latch: latch.trip() for latch in named(word)}
    return {latch: trip for latch, trip in trips.items() if trip is not None}


def latch_lost_runs(bench: str) -> list[UnlatchedRun]:
    """Latch a bench on real buses for every run of it that nothing is left of: who knows what its devices do.

    A latch that is there gets the cause beside its own, so that whoever resets it reads both; one that names the
    same process was set by its watchdog, and stays. Returns the runs whose latch could not be written, or whose file
    could be neither removed nor marked: that file holds the bench, until a reset.
    """
    unlatched = []
    for run in runs_underway.lost(bench):
        latch = Latch(bench, bench, (str(run.place.directory / f"{bench}{SUFFIX}"),), run.place.shared)
        trip = latch.trip()
        try:
            if trip is None or f"process {run.process} " not in trip.cause:
                latch.set(f"{trip.cause}; {run.cause}" if trip else run.cause, Path(run.recording))
            runs_underway.forget(run)
        except LeactlError as error:
            unlatched.append(UnlatchedRun(run, str(error)))
    return unlatched


def refuse_lost_runs(bench: str) -> None:
    """Latch a bench for its lost runs, and refuse it where a latch could not be written.

    Raises
    ------
    SafetyTrip : with the cause, what could not be written, and the command that resets it.
    """
    for run in latch_lost_runs(bench):
        raise SafetyTrip(
            f"bench '{bench}' is tripped: {run.lost.cause}; {run.fault}; see: leactl bench reset {shlex.quote(bench)}"
        )


def _of_file(bench: str, file: Path) -> Latch:
    """The latch of a bench emulated here: by the file that its links lead to, in the user's own place."""
    path = file.resolve()
    resets = path.stem if path.parent == benchfile.SHIPPED.resolve() else str(path)
    digest = sha256(os.fsencode(path)).hexdigest()[:DIGITS]
    return Latch(bench, resets, (str(state_folder.state_directory() / f"{bench}@{digest}{SUFFIX}"),))


def _by_name(bench: str, of_files: bool = True) -> Iterator[Latch]:
    """The latches that lie anywhere for benches of this name, which has no `@`."""
    for place in state_folder.places():
        with suppress(OSError):
            for path in sorted(place.directory.iterdir()):
                key, suffix, rest = path.name.partition(SUFFIX)
                if suffix and not rest and (key == bench or (of_files and key.partition("@")[0] == bench)):
                    yield Latch(bench, bench, (str(path),), place.shared)


def _trip(bench: str, path: Path) -> Trip | None:
    try:
        text = state_folder.read(path)
    except FileNotFoundError:
        return None
    except OSError as error:
        return Trip(bench, f"unknown, {path} cannot be read: {error.strerror or error}", "", "")
    if text.strip() == RELEASED.strip():
        return None
    try:
        told = astuple(Trip(**json.loads(text)))
    except (ValueError, TypeError, RecursionError) as error:
        return Trip(bench, f"unknown, {path} cannot be read: {error}", "", "")
    if not all(isinstance(value, str) for value in told):
        return Trip(bench, f"unknown, {path} cannot be read: texts were expected", "", "")
    return Trip(*map(printable, told))  # a line each, whatever somebody wrote there
