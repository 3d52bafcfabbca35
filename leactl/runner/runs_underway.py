"""Runs under way: each keeps a file that tells what it is, and through which others ask it to stop, to pause or remark.

A run locks its file for as long as its process lives, which tells a run from what a kill left behind; and since nothing
is signalled, no process that took over a number can be hit. The loop looks at two bytes of it, mapped into its memory.
A run on real buses announces itself to every user of the machine, any of whom may stop it.
"""

import errno
import json
import mmap
import os
import secrets
import stat
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from leactl.driver.contract import Confirmation
from leactl.errors import DeviceError, InputError
from leactl.regular_files import AS_BYTES, AT_ONCE, NO_LINK, read_at, write_at
from leactl.runner import lock_holders, state_folder
from leactl.runner.state_folder import Place
from leactl.yamlfile import printable

GOES_ON, STOP, PAUSE = b"-", b"!", b"="
HEAD = 2  # bytes: the first asks for a stop and the second for a pause, so that neither can undo the other
CAUSE = "stopped by `leactl bench stop`"
LOOK_EVERY_S = 0.02
MOST_TOLD = 1 << 22  # bytes, with thousands of remarks


class Announcement:
    """The run's own end of its file."""

    def __init__(self, descriptor: int, fault: str = "", path: Path | None = None, shared: bool = False) -> None:
        self.fault = fault  # why nobody can find it
        self._descriptor, self._path, self._shared = descriptor, path, shared
        self._head = mmap.mmap(descriptor, HEAD, access=mmap.ACCESS_READ)
        self._read_to = HEAD
        self._telling = threading.Lock()

    def renew(self) -> None:
        """Make the file anew where it was removed, exchanged or moved: nobody else could find this run any more.

        It is called beside the loop, whose next look is at the new file; a disk that takes nothing is nothing to a run.
        """
        if self._path is None:
            return
        with suppress(OSError), self._telling:
            if state_folder.in_place(self._descriptor, self._path):
                return
            with suppress(FileNotFoundError):
                self._path.rename(self._path.with_name(f"{self._path.name}.{secrets.token_hex(4)}.aside"))
            told = read_at(self._descriptor, MOST_TOLD, 0)
            descriptor = _locked(self._path, told, self._shared)
            self._descriptor, self._head = descriptor, mmap.mmap(descriptor, HEAD, access=mmap.ACCESS_READ)

    def asked(self) -> str:
        """The cause to stop for, once somebody has asked; empty before."""
        return CAUSE if self._head[0] == STOP[0] else ""

    @property
    def paused(self) -> bool:
        """Whether somebody has asked for a pause."""
        return self._head[1] == PAUSE[0]

    def pause(self, wanted: bool) -> None:
        """Ask for a pause, or for its end, as another process does."""
        write_at(self._descriptor, PAUSE if wanted else GOES_ON, 1)

    def remarks(self) -> list[str]:
        """What has been remarked since this was asked last."""
        if os.fstat(self._descriptor).st_size <= self._read_to:
            return []
        text = read_at(self._descriptor, state_folder.MOST_BYTES, self._read_to)
        whole = text[: text.rfind(b"\n") + 1]  # a line that is being written is read the next time
        self._read_to += len(whole)
        return [str(line["remark"]) for line in _lines(whole) if "remark" in line]

    def tell(self, **what: Any) -> None:
        """Add to what the file tells; a disk that takes nothing is nothing to a run."""
        with suppress(OSError), self._telling:
            os.lseek(self._descriptor, 0, os.SEEK_END)
            os.write(self._descriptor, _line(what))

    def tell_safe(self, safe: Mapping[str, Confirmation]) -> None:
        """Tell what every device answered when it was made safe."""
        self.tell(safe={name: {"confirmed": c.safe, "detail": c.detail} for name, c in safe.items()})

    def close(self) -> None:
        """Let go: from here on the run has ended."""
        self._head.close()
        os.close(self._descriptor)


@contextmanager
def announced(
    bench: str, bench_file: str, protocol: str, needed: bool, place: Place | None = None
) -> Iterator[Announcement]:
    """Let a run be found and stopped by other processes until the block is left.

    Where it is not `needed`, for the run's devices end with it, and no file can be kept, the run tells itself what
    nobody hears. Without a `place` it is its user's own.

    Raises
    ------
    InputError : there is no place for the file.
    """
    place = place or state_folder.of_user()
    path = place.runs / f"{bench}.{os.getpid()}.{secrets.token_hex(4)}.run"
    file = str(Path(bench_file).resolve())
    about = {"bench": bench, "file": file, "protocol": protocol, "process": os.getpid(), "real": needed}
    try:
        descriptor = _locked(path, 2 * GOES_ON + _line(about), place.shared)
        announcement = Announcement(descriptor, path=path, shared=place.shared)
    except OSError as error:
        fault = f"{path.parent}: `leactl bench stop` cannot reach this run: {error.strerror or error}"
        if needed:
            raise InputError(f"{fault}; set LEACTL_STATE to a directory that can be written") from None
        nowhere = _nowhere()
        os.write(nowhere, 2 * GOES_ON)
        announcement = Announcement(nowhere, fault)
    try:
        yield announcement
    except BaseException as error:
        announcement.tell(status="failed", reason=(str(error) or type(error).__name__).splitlines()[0])
        raise
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)
        announcement.close()


def _nowhere() -> int:
    """A file without a name; in memory where the system has such."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("run")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _locked(path: Path, text: bytes, shared: bool) -> int:
    """Make a file that is locked before anybody finds it, for one without a lock is taken for an ended run's."""
    try:
        import fcntl
    except ImportError:
        raise OSError(errno.ENOSYS, "this system has no locks of files") from None
    hidden = path.with_suffix(".tmp")
    descriptor = state_folder.opened(hidden, shared)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.write(descriptor, text)
        hidden.rename(path)
    except BaseException:
        os.close(descriptor)
        hidden.unlink(missing_ok=True)
        raise
    return descriptor


@dataclass
class RunUnderway:
    """Another process's end of a run's file; it stays readable after the run has removed it."""

    bench: str
    file: str
    protocol: str
    process: int
    descriptor: int

    def __str__(self) -> str:
        return f"{self.protocol} on {self.bench}, process {self.process}"

    def ask_to_stop(self) -> None:
        """Ask; the run sees it in its next cycle.

        Raises
        ------
        DeviceError : this user may not.
        """
        self._ask("stop", lambda: write_at(self.descriptor, STOP, 0))

    def ask_to_pause(self, wanted: bool) -> None:
        """Ask for a pause, which begins at the run's next rest, or for its end.

        Raises
        ------
        DeviceError : this user may not.
        """
        byte = PAUSE if wanted else GOES_ON
        self._ask("pause" if wanted else "go on", lambda: write_at(self.descriptor, byte, 1))

    def remark(self, text: str) -> None:
        """Have the run record a remark with the moment at which it sees it.

        Raises
        ------
        DeviceError : this user may not.
        """

        def append() -> None:
            end = os.open(f"/proc/self/fd/{self.descriptor}", os.O_WRONLY | os.O_APPEND)  # whole, whoever else remarks
            try:
                os.write(end, _line({"remark": text}))
            finally:
                os.close(end)

        self._ask("record a remark", append)

    def _ask(self, what: str, write: Callable[[], object]) -> None:
        try:
            write()
        except OSError as error:
            reason: object = error.strerror or error
            if error.errno in (errno.EBADF, errno.EACCES):  # it could be opened for reading alone
                owner = os.fstat(self.descriptor).st_uid
                reason = f"no permission; the run is that of user {owner}, who may, as root may"
            raise DeviceError(f"{self}: cannot be asked to {what}: {reason}") from None

    def wait(self, deadline: float) -> bool:
        """Whether the run's process has ended it, looked for until this moment of `time.monotonic`."""
        while not _ended(self.descriptor):
            if time.monotonic() >= deadline:
                return False
            time.sleep(LOOK_EVERY_S)
        return True

    def told(self) -> dict[str, Any]:
        """All that the run has told by now: `safe` once its devices are, then `status`, `reason` and `run`."""
        told = _told(self.descriptor)
        bent = [key for key in ("status", "reason", "run") if not isinstance(told.get(key, ""), str)]
        return {
            key: printable(value) if isinstance(value, str) else value for key, value in told.items() if key not in bent
        }

    def close(self) -> None:
        """Let the file go."""
        os.close(self.descriptor)


class LostRun(NamedTuple):
    """A run that ended without telling that its devices are safe."""

    process: object  # its number
    cause: str  # what is said of it
    recording: str
    place: Place  # that it announced itself in
    path: Path  # of its file
    last_told: str  # ISO 8601, UTC: when it was last heard of


def lost(bench: str) -> list[LostRun]:
    """Runs of a bench that ended without telling that its devices are safe; each counts until it is forgotten."""
    runs = []
    for place, path in [(each, path) for each in state_folder.places() for path in sorted(each.runs.glob("*.run"))]:
        with suppress(OSError):  # what is no run's file is told by whoever asks what runs
            descriptor = _opened(path)
            if descriptor is None:
                continue
            try:
                if not _ended(descriptor) or (about := _told(descriptor)).get("bench") != bench:
                    continue
                if _is_over(about):
                    path.unlink(missing_ok=True)
                    continue
                run = f"process {about.get('process')} of the run {about.get('protocol')}"
                cause = f"{run} ended without a word, and its watchdog too"
                last_told = datetime.fromtimestamp(os.fstat(descriptor).st_mtime, UTC).isoformat(timespec="seconds")
                runs.append(LostRun(about.get("process"), cause, str(about.get("run", "none")), place, path, last_told))
            finally:
                os.close(descriptor)
    return runs


def forget(run: LostRun) -> None:
    """Remove what a lost run left behind; where the folder does not allow that, mark the file as told.

    Raises
    ------
    InputError : neither is possible; the run is lost still.
    """
    with suppress(OSError):
        run.path.unlink(missing_ok=True)
        return
    try:
        descriptor = _opened(run.path)
        if descriptor is None:
            return
        try:
            os.lseek(descriptor, 0, os.SEEK_END)
            os.write(descriptor, _line({"safe": {}}))
        finally:
            os.close(descriptor)
    except OSError as error:
        raise InputError(
            f"{run.path}: can be neither removed nor written: {error.strerror or error}; it holds the bench until its"
            " owner, or root, removes it"
        ) from None


def _is_over(told: Mapping[str, Any]) -> bool:
    """Whether a run has told that every device is safe, or had none but what ended with it."""
    if not told.get("real"):
        return True
    safe = told.get("safe")
    return isinstance(safe, dict) and all(device["confirmed"] is True for device in safe.values())


def _is_of_devices(safe: object) -> bool:
    return isinstance(safe, dict) and all(
        isinstance(device, dict) and {"confirmed", "detail"} <= device.keys() for device in safe.values()
    )


def running() -> tuple[list[RunUnderway], list[str]]:
    """Every run that is under way by its own file, and a line for each file that cannot be read.

    What a run left behind that ended with safe devices is removed; the next run is told of the others (`lost`).
    """
    places, faults = state_folder.reachable()
    underway = []
    for path in [path for place in places for path in sorted(place.runs.glob("*.run"))]:
        try:
            descriptor = _opened(path)
        except OSError as error:
            faults.append(f"{path}: cannot be read, and may hide what runs: {error.strerror or error}")
            continue
        if descriptor is None:
            continue
        if _ended(descriptor):
            if _is_over(_told(descriptor)):
                with suppress(OSError):
                    path.unlink(missing_ok=True)
            os.close(descriptor)
            continue
        about = _told(descriptor)
        unknown = {"bench": "unknown", "file": "", "protocol": path.name}
        texts = {
            key: printable(about[key]) if isinstance(about.get(key), str) else other for key, other in unknown.items()
        }
        process = about.get("process")
        process = process if isinstance(process, int) else 0
        underway.append(RunUnderway(**texts, process=process, descriptor=descriptor))
    return underway, faults


def unseen(bench: str) -> str:
    """What is said of a real bench that a process holds, although no run's file tells of it; empty where none does."""
    held = lock_holders.holder(lock_holders.lock_of(f"bench-{bench}"))
    if held is None:
        return ""
    return (
        f"bench '{bench}' is driven by process {held[0]}, whose file cannot be found: switch off the supply, or end it"
        f" in order by: kill {held[0]}"
    )


def _opened(path: Path) -> int | None:
    """Open a run's file, for reading alone where another user's permits no more; None where it has gone.

    Raises
    ------
    OSError : it is a link or no regular file, which no run makes, or this user may not.
    """
    safely = NO_LINK | AT_ONCE | AS_BYTES
    try:
        try:
            descriptor = os.open(path, os.O_RDWR | safely)
        except (PermissionError, IsADirectoryError):
            descriptor = os.open(path, os.O_RDONLY | safely)
    except FileNotFoundError:
        return None
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return descriptor
    os.close(descriptor)
    raise OSError("a regular file was expected; remove what lies there")


def _ended(descriptor: int) -> bool:
    import fcntl  # of POSIX alone: elsewhere no run leaves such a file

    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _told(descriptor: int) -> dict[str, Any]:
    told: dict[str, Any] = {}
    for line in _lines(read_at(descriptor, MOST_TOLD, HEAD)):
        told |= line
    if not _is_of_devices(told.get("safe", {})):
        del told["safe"]
    return told


def _lines(text: bytes) -> Iterator[dict[str, Any]]:
    """Objects, one a line."""
    for line in text.split(b"\n")[:-1]:  # the last one is empty, or not whole yet
        with suppress(ValueError, RecursionError):  # cut short by a full disk, or bent
            told = json.loads(line)
            if isinstance(told, dict):
                yield told


def _line(what: Mapping[str, Any]) -> bytes:
    return json.dumps(what).encode() + b"\n"
