"""Directories for state that outlives a process: one of the machine for benches on real buses, one of each user for
rehearsals.

Files in the machine's directory belong to every login: they are made anew or opened as they are, never through a link,
never blocking, and written in place, since in a sticky directory nobody may remove another user's file.
"""

import os
import shlex
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from leactl.errors import InputError
from leactl.regular_files import BINARY, NOFOLLOW, NONBLOCK

if TYPE_CHECKING:  # an emergency stop imports this: nothing heavy comes with it
    from leactl.bench.benchfile import BenchFile
    from leactl.bench.host_checks import HostFinding

MACHINE_DIRECTORY = "/var/lib/leactl"
SHARED_FILE_MODE, OWNER_FILE_MODE = 0o666, 0o644
SHARED_DIRECTORY_MODE = 0o1777  # every login may add files, nobody may remove another's
MOST_BYTES = 1 << 16  # of a file of state, most of which have a few hundred


@dataclass(frozen=True)
class StateFolder:
    """A directory of state; `fault` says why it is not the directory that all users share."""

    directory: Path
    shared: bool  # by all users of this machine
    fault: str = ""

    @property
    def runs(self) -> Path:
        """Folder for files of runs under way; a shared directory has no subfolder: another user could exchange it."""
        return self.directory if self.shared else self.directory / "runs"

    def winding_file(self, actuator: str) -> Path:
        """Return the file of one actuator's winding memory."""
        if self.shared:
            return self.directory / f"{actuator}.thermal.json"
        return self.directory / "thermal" / f"{actuator}.json"


def state_directory() -> Path:
    """Return the user's directory: `LEACTL_STATE`, else the state directory of the XDG specification.

    Raises
    ------
    InputError : neither variable is set and the user has no home directory; or `LEACTL_STATE` is a relative path.
    """
    text = os.environ.get("LEACTL_STATE")
    if text:
        return _absolute("LEACTL_STATE", text)
    xdg = os.environ.get("XDG_STATE_HOME", "")
    try:
        # the XDG specification demands that relative paths be ignored: they would differ with the working folder
        return (Path(xdg) if Path(xdg).is_absolute() else Path.home() / ".local" / "state") / "leactl"
    except RuntimeError:
        raise InputError("there is no home directory for leactl's state; set LEACTL_STATE to a directory") from None


def of_user() -> StateFolder:
    """Return the folder of a user's own state."""
    return StateFolder(state_directory(), shared=False)


def of_machine() -> StateFolder:
    """Return the folder of this machine's state for all users; if it is not usable, the user's folder with the reason.

    `LEACTL_MACHINE_STATE` replaces /var/lib/leactl in tests of leactl itself.
    """
    directory = _machine_directory()
    fault = _make_shared_directory(directory)
    return StateFolder(state_directory(), shared=False, fault=fault) if fault else StateFolder(directory, shared=True)


def folder_of(bench: "BenchFile", in_process: bool) -> StateFolder:
    """Return the folder of a bench's latch and winding memory.

    A bench that another process serves is treated like a real one, unless `LEACTL_STATE` keeps its rehearsals apart.
    """
    separate = bench.emulated is not None and bool(os.environ.get("LEACTL_STATE"))
    return of_user() if in_process or separate else of_machine()


def folders() -> list[StateFolder]:
    """Return every folder that may hold files to read: first the machine's, writable or not, then the user's."""
    return [StateFolder(_machine_directory(), shared=True), of_user()]


def reachable() -> tuple[list[StateFolder], list[str]]:
    """Return the folders that can be read, and one line for each that cannot, for callers that must continue."""
    reached: list[StateFolder] = []
    faults: list[str] = []
    for shared, directory in ((True, _machine_directory), (False, state_directory)):
        try:
            folder = StateFolder(directory(), shared)
        except InputError as error:
            faults.append(str(error))
            continue
        if os.path.lexists(folder.runs) and not folder.runs.is_dir():
            faults.append(f"{folder.runs}: a directory of runs was expected; runs under way there cannot be listed")
        else:
            reached.append(folder)
    return reached, faults


def examine() -> "HostFinding":
    """Report where locks, trip latches and winding memory of real benches are, and whether all users share them."""
    from leactl.bench.host_checks import HostFinding

    directory = _machine_directory()
    locks = "locks in the kernel, shared by all users; trip latches and winding memory in"
    fault = _why_unusable(directory)
    if not fault and os.lstat(directory).st_mode & SHARED_DIRECTORY_MODE != SHARED_DIRECTORY_MODE:
        fault = f"{directory}: not every user can write there"
    if not fault or (not os.path.lexists(directory) and os.access(directory.parent, os.W_OK)):  # the first run makes it
        return HostFinding("state", True, False, f"{locks} {directory}, shared by all users")
    remedy = f"sudo install -d -o root -m 1777 {shlex.quote(str(directory))}"
    used = state_directory() if _why_unusable(directory) else directory
    return HostFinding("state", False, False, f"{locks} {used}, this user's alone ({fault})", remedy)


def read(path: Path) -> bytes:
    """Return the content of a regular file of state.

    Raises
    ------
    FileNotFoundError : nothing is at the path.
    OSError : the file is not regular, a link, or larger than `MOST_BYTES`.
    """
    descriptor = os.open(path, os.O_RDONLY | NOFOLLOW | NONBLOCK | BINARY)
    try:
        _expect_regular(descriptor, path)
        content = os.read(descriptor, MOST_BYTES + 1)
    finally:
        os.close(descriptor)
    if len(content) > MOST_BYTES:
        raise OSError(f"more than {MOST_BYTES} bytes")
    return content


def open_file(path: Path, shared: bool) -> int:
    """Open a regular file of state for reading and writing; make it if there is none.

    Raises
    ------
    OSError : the file cannot be made, or is a link or not regular.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    flags = os.O_RDWR | NOFOLLOW | NONBLOCK | BINARY
    try:
        descriptor = os.open(path, flags | os.O_CREAT | os.O_EXCL, OWNER_FILE_MODE)
    except FileExistsError:
        # without O_CREAT: in a sticky directory the kernel refuses that for another user's file (fs.protected_regular)
        descriptor = os.open(path, flags)
    else:
        if shared:  # only Linux has a shared directory, so fchmod exists
            os.fchmod(descriptor, SHARED_FILE_MODE)
    try:
        _expect_regular(descriptor, path)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def is_at_path(descriptor: int, path: Path) -> bool:
    """Return, without opening the path, whether an open file is still the one there: not removed, moved or replaced."""
    try:
        at_path, opened_file = os.lstat(path), os.fstat(descriptor)
    except OSError:
        return False
    return (at_path.st_dev, at_path.st_ino) == (opened_file.st_dev, opened_file.st_ino)


def _machine_directory() -> Path:
    return _absolute("LEACTL_MACHINE_STATE", os.environ.get("LEACTL_MACHINE_STATE") or MACHINE_DIRECTORY)


def _absolute(variable: str, text: str) -> Path:
    if not Path(text).is_absolute():
        raise InputError(
            f"{variable} is {text}: an absolute path was expected; a relative one depends on the working folder"
        )
    return Path(text)


def _make_shared_directory(directory: Path) -> str:
    """Make the shared directory if there is none; return why it cannot be used, or an empty string."""
    try:
        directory.mkdir()
        directory.chmod(SHARED_DIRECTORY_MODE)
    except FileExistsError:
        pass
    except OSError as error:
        return f"{directory}: cannot be made: {error.strerror}"
    return _why_unusable(directory)


def _why_unusable(directory: Path) -> str:
    """Return why a directory cannot be used by this user, or an empty string."""
    try:
        status = os.lstat(directory)
    except OSError as error:
        return f"{directory}: {error.strerror}"
    if not stat.S_ISDIR(status.st_mode):
        return f"{directory}: is no directory"
    if hasattr(os, "geteuid") and status.st_uid not in (0, os.geteuid()):
        return f"{directory}: belongs to user {status.st_uid}, who could exchange what is in it; root was expected"
    if not os.access(directory, os.W_OK | os.X_OK):
        return f"{directory}: no permission to write there"
    return ""


def _expect_regular(descriptor: int, path: Path) -> None:
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        raise OSError(f"{path} is no regular file")
