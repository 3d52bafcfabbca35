"""Files of runs under way: each describes its run, and through it other processes ask for a stop, a pause or a remark.

A run locks its file while its process lives: a file without a lock was left behind by a killed run. No process is
signalled, so that none is hit that has taken over a process number. The loop reads two bytes of its file, mapped into
memory. A run on real buses announces itself to every user of the machine, any of whom may stop it.
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
from leactl.regular_files import BINARY, NOFOLLOW, NONBLOCK, read_at, write_at
from leactl.runner import lock_holders, state_folder
from leactl.runner.state_folder import StateFolder
from leactl.yamlfile import printable

GOES_ON, STOP, PAUSE = b"-", b"!", b"="  # values of the bytes of the head
HEAD_BYTES = 2  # the first asks for a stop and the second for a pause, so that neither undoes the other
STOP_CAUSE = "stopped by `leactl bench stop`"
POLL_INTERVAL_S = 0.02
MOST_READ_BYTES = 1 << 22  # of a file; as much holds thousands of remarks


class Announcement:
    """File of a run as the run itself uses it."""

    def __init__(self, descriptor: int, fault: str = "", path: Path | None = None, shared: bool = False) -> None:
        self.fault = fault  # why no other process can find the file
        self._descriptor, self._path, self._shared = descriptor, path, shared
        self._head = mmap.mmap(descriptor, HEAD_BYTES, access=mmap.ACCESS_READ)
        self._read_to = HEAD_BYTES
        self._append_lock = threading.Lock()

    def renew(self) -> None:
        """Make the file anew if it was removed, exchanged or moved: otherwise no other process would find the run.

        It is called from another thread than the loop, which reads the new file next. A failure to write is ignored.
        """
        if self._path is None:
            return
        with suppress(OSError), self._append_lock:
            if state_folder.is_at_path(self._descriptor, self._path):
                return
            with suppress(FileNotFoundError):
                self._path.rename(self._path.with_name(f"{self._path.name}.{secrets.token_hex(4)}.aside"))
            text = read_at(self._descriptor, MOST_READ_BYTES, 0)
            descriptor = _make_locked_file(self._path, text, self._shared)
            self._descriptor, self._head = descriptor, mmap.mmap(descriptor, HEAD_BYTES, access=mmap.ACCESS_READ)

    def stop_cause(self) -> str:
        """Return the cause of a stop that another process has asked for, else an empty string."""
        return STOP_CAUSE if self._head[0] == STOP[0] else ""

    @property
    def paused(self) -> bool:
        """Whether a pause is asked for."""
        return self._head[1] == PAUSE[0]

    def pause(self, is_wanted: bool) -> None:
        """Ask for a pause, or for its end, from the process of the run."""
        write_at(self._descriptor, PAUSE if is_wanted else GOES_ON, 1)

    def remarks(self) -> list[str]:
        """Return the remarks since the last call."""
        if os.fstat(self._descriptor).st_size <= self._read_to:
            return []
        text = read_at(self._descriptor, state_folder.MOST_BYTES, self._read_to)
        complete_lines = text[: text.rfind(b"\n") + 1]  # a line that is being written is read the next time
        self._read_to += len(complete_lines)
        return [str(line["remark"]) for line in _lines(complete_lines) if "remark" in line]

    def tell(self, **facts: Any) -> None:
        """Append facts to the file; a failure to write is ignored."""
        with suppress(OSError), self._append_lock:
            os.lseek(self._descriptor, 0, os.SEEK_END)
            os.write(self._descriptor, _line(facts))

    def tell_safe(self, confirmations: Mapping[str, Confirmation]) -> None:
        """Append the confirmation of every device that was made safe."""
        self.tell(
            safe={name: {"confirmed": device.safe, "detail": device.detail} for name, device in confirmations.items()}
        )

    def close(self) -> None:
        """Close the file, which ends the run for other processes."""
        self._head.close()
        os.close(self._descriptor)


@contextmanager
def announced(
    bench: str, bench_file: str, protocol: str, is_needed: bool, folder: StateFolder | None = None
) -> Iterator[Announcement]:
    """Let a run be found and stopped by other processes until the block is left.

    Parameters
    ----------
    is_needed : whether the run must not begin without the file, because its devices do not end with the run. If it is
        False and no file can be made, a file without a name takes its place.
    folder : folder of the file; None: the user's own state folder.

    Raises
    ------
    InputError : the file is needed and cannot be made.
    """
    folder = folder or state_folder.of_user()
    path = folder.runs / f"{bench}.{os.getpid()}.{secrets.token_hex(4)}.run"
    file = str(Path(bench_file).resolve())
    run_facts = {"bench": bench, "file": file, "protocol": protocol, "process": os.getpid(), "real": is_needed}
    try:
        descriptor = _make_locked_file(path, 2 * GOES_ON + _line(run_facts), folder.shared)
        announcement = Announcement(descriptor, path=path, shared=folder.shared)
    except OSError as error:
        fault = f"{path.parent}: `leactl bench stop` cannot reach this run: {error.strerror or error}"
        if is_needed:
            raise InputError(f"{fault}; set LEACTL_STATE to a directory that can be written") from None
        nameless_file = _nameless_file()
        os.write(nameless_file, 2 * GOES_ON)
        announcement = Announcement(nameless_file, fault)
    try:
        yield announcement
    except BaseException as error:
        announcement.tell(status="failed", reason=(str(error) or type(error).__name__).splitlines()[0])
        raise
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)
        announcement.close()


def _nameless_file() -> int:
    """Open a file without a name, in memory if the system has such files."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("run")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _make_locked_file(path: Path, text: bytes, shared: bool) -> int:
    """Make a file that is locked before it gets its name, as a file without a lock counts as that of an ended run.

    Return its descriptor.
    """
    try:
        import fcntl
    except ImportError:
        raise OSError(errno.ENOSYS, "this system has no locks of files") from None
    unnamed_path = path.with_suffix(".tmp")
    descriptor = state_folder.open_file(unnamed_path, shared)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.write(descriptor, text)
        unnamed_path.rename(path)
    except BaseException:
        os.close(descriptor)
        unnamed_path.unlink(missing_ok=True)
        raise
    return descriptor


@dataclass
class RunUnderway:
    """File of a run as another process uses it; it stays readable after the run has removed it."""

    bench: str
    file: str
    protocol: str
    process: int
    descriptor: int

    def __str__(self) -> str:
        return f"{self.protocol} on {self.bench}, process {self.process}"

    def ask_to_stop(self) -> None:
        """Ask for a stop, which the run sees in its next cycle.

        Raises
        ------
        DeviceError : this user may not write to the file.
        """
        self._ask("stop", lambda: write_at(self.descriptor, STOP, 0))

    def ask_to_pause(self, is_wanted: bool) -> None:
        """Ask for a pause, which begins at the run's next rest, or for its end.

        Raises
        ------
        DeviceError : this user may not write to the file.
        """
        byte = PAUSE if is_wanted else GOES_ON
        self._ask("pause" if is_wanted else "go on", lambda: write_at(self.descriptor, byte, 1))

    def remark(self, text: str) -> None:
        """Have the run record a remark, with the time at which the run reads it.

        Raises
        ------
        DeviceError : this user may not write to the file.
        """

        def append() -> None:
            # with O_APPEND several processes append whole lines
            append_descriptor = os.open(f"/proc/self/fd/{self.descriptor}", os.O_WRONLY | os.O_APPEND)
            try:
                os.write(append_descriptor, _line({"remark": text}))
            finally:
                os.close(append_descriptor)

        self._ask("record a remark", append)

    def _ask(self, request: str, write: Callable[[], object]) -> None:
        """Call `write`; a failure raises a DeviceError that names the request and the reason."""
        try:
            write()
        except OSError as error:
            reason: object = error.strerror or error
            if error.errno in (errno.EBADF, errno.EACCES):  # this user may only read the file
                owner = os.fstat(self.descriptor).st_uid
                reason = f"no permission; the run is that of user {owner}, who may, as root may"
            raise DeviceError(f"{self}: cannot be asked to {request}: {reason}") from None

    def wait(self, deadline: float) -> bool:
        """Wait until the run has ended or until `deadline` of `time.monotonic` [s]; return whether it has ended."""
        while not _has_ended(self.descriptor):
            if time.monotonic() >= deadline:
                return False
            time.sleep(POLL_INTERVAL_S)
        return True

    def facts(self) -> dict[str, Any]:
        """Return all facts in the file: `safe` once the devices are safe, then `status`, `reason` and `run`."""
        facts = _facts(self.descriptor)
        malformed = [key for key in ("status", "reason", "run") if not isinstance(facts.get(key, ""), str)]
        return {
            key: printable(value) if isinstance(value, str) else value
            for key, value in facts.items()
            if key not in malformed
        }

    def close(self) -> None:
        """Close the file."""
        os.close(self.descriptor)


class LostRun(NamedTuple):
    """A run that ended without recording that its devices are safe."""

    process: object  # its number
    cause: str  # for the trip that it latches
    recording: str
    folder: StateFolder  # in which its file is
    path: Path  # of its file
    last_written: str  # ISO 8601, UTC: when its file was last written


def lost(bench: str) -> list[LostRun]:
    """Return the runs of a bench that ended without recording that its devices are safe, except forgotten ones."""
    runs = []
    for folder, path in [
        (state, path) for state in state_folder.folders() for path in sorted(state.runs.glob("*.run"))
    ]:
        with suppress(OSError):  # `running` reports a file that is no run's
            descriptor = _open_file(path)
            if descriptor is None:
                continue
            try:
                if not _has_ended(descriptor) or (run_facts := _facts(descriptor)).get("bench") != bench:
                    continue
                if _is_over(run_facts):
                    path.unlink(missing_ok=True)
                    continue
                run = f"process {run_facts.get('process')} of the run {run_facts.get('protocol')}"
                cause = f"{run} ended without a word, and its watchdog too"
                last_written = datetime.fromtimestamp(os.fstat(descriptor).st_mtime, UTC).isoformat(timespec="seconds")
                runs.append(
                    LostRun(
                        run_facts.get("process"), cause, str(run_facts.get("run", "none")), folder, path, last_written
                    )
                )
            finally:
                os.close(descriptor)
    return runs


def forget(run: LostRun) -> None:
    """Remove the file of a lost run; where the folder forbids that, mark the file as that of a safe run.

    Raises
    ------
    InputError : neither is possible; the run still counts as lost.
    """
    with suppress(OSError):
        run.path.unlink(missing_ok=True)
        return
    try:
        descriptor = _open_file(run.path)
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


def _is_over(facts: Mapping[str, Any]) -> bool:
    """Return whether a run has recorded that every device is safe, or had only devices that ended with the run."""
    if not facts.get("real"):
        return True
    safe = facts.get("safe")
    return isinstance(safe, dict) and all(device["confirmed"] is True for device in safe.values())


def _is_safe_fact(value: object) -> bool:
    """Return whether a value has the form that `tell_safe` writes."""
    return isinstance(value, dict) and all(
        isinstance(device, dict) and {"confirmed", "detail"} <= device.keys() for device in value.values()
    )


def running() -> tuple[list[RunUnderway], list[str]]:
    """Return every run under way, and one line for each file that cannot be read.

    Files of runs that ended with safe devices are removed; the others remain for `lost`.
    """
    folders, faults = state_folder.reachable()
    underway = []
    for path in [path for folder in folders for path in sorted(folder.runs.glob("*.run"))]:
        try:
            descriptor = _open_file(path)
        except OSError as error:
            faults.append(f"{path}: cannot be read, and may hide what runs: {error.strerror or error}")
            continue
        if descriptor is None:
            continue
        if _has_ended(descriptor):
            if _is_over(_facts(descriptor)):
                with suppress(OSError):
                    path.unlink(missing_ok=True)
            os.close(descriptor)
            continue
        run_facts = _facts(descriptor)
        default_texts = {"bench": "unknown", "file": "", "protocol": path.name}
        texts = {
            key: printable(run_facts[key]) if isinstance(run_facts.get(key), str) else default
            for key, default in default_texts.items()
        }
        process = run_facts.get("process")
        process = process if isinstance(process, int) else 0
        underway.append(RunUnderway(**texts, process=process, descriptor=descriptor))
    return underway, faults


def unseen(bench: str) -> str:
    """Return a line on a real bench that a process holds without a file of its run, else an empty string."""
    holder = lock_holders.holder(lock_holders.lock_of(f"bench-{bench}"))
    if holder is None:
        return ""
    return (
        f"bench '{bench}' is driven by process {holder[0]}, whose file cannot be found: switch off the supply, or end"
        f" it in order by: kill {holder[0]}"
    )


def _open_file(path: Path) -> int | None:
    """Open a run's file, for reading alone if its permissions allow no more; return None if it is gone.

    Raises
    ------
    OSError : it is a link or no regular file, which no run makes, or this user may not read it.
    """
    flags = NOFOLLOW | NONBLOCK | BINARY
    try:
        try:
            descriptor = os.open(path, os.O_RDWR | flags)
        except (PermissionError, IsADirectoryError):
            descriptor = os.open(path, os.O_RDONLY | flags)
    except FileNotFoundError:
        return None
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return descriptor
    os.close(descriptor)
    raise OSError("a regular file was expected; remove what lies there")


def _has_ended(descriptor: int) -> bool:
    """Return whether no process has locked a run's file any more."""
    import fcntl  # of POSIX alone: elsewhere no run leaves such a file

    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _facts(descriptor: int) -> dict[str, Any]:
    """Return the facts in a run's file; later lines replace earlier ones, and a malformed `safe` is left out."""
    facts: dict[str, Any] = {}
    for line in _lines(read_at(descriptor, MOST_READ_BYTES, HEAD_BYTES)):
        facts |= line
    if not _is_safe_fact(facts.get("safe", {})):
        del facts["safe"]
    return facts


def _lines(text: bytes) -> Iterator[dict[str, Any]]:
    """Yield the JSON objects of a text, one on each line; other lines are skipped."""
    for line in text.split(b"\n")[:-1]:  # the last line is empty, or not complete yet
        with suppress(ValueError, RecursionError):  # cut short by a full disk, or malformed
            value = json.loads(line)
            if isinstance(value, dict):
                yield value


def _line(facts: Mapping[str, Any]) -> bytes:
    return json.dumps(facts).encode() + b"\n"
