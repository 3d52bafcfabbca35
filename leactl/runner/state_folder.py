"""Where leactl keeps what outlives a process: of a bench on real buses for the machine, of a rehearsal for its user.

Files in the machine's directory are every login's: made anew or opened as they are, never through a link, never one
that blocks, and written in place, since a sticky directory lets nobody take another user's file away.
"""

import os
import shlex
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from leactl.errors import InputError
from leactl.regular_files import AS_BYTES, AT_ONCE, NO_LINK

if TYPE_CHECKING:  # an emergency stop imports this: nothing heavy comes with it
    from leactl.bench.benchfile import BenchFile
    from leactl.bench.host_checks import HostFinding

MACHINE = "/var/lib/leactl"
OF_EVERYBODY, OF_ITS_OWNER = 0o666, 0o644
SHARED_DIRECTORY = 0o1777  # every login adds files, nobody removes another's
MOST_BYTES = 1 << 16  # of a file of state, which has a few hundred


@dataclass(frozen=True)
class Place:
    """A directory of state, and why it is not the one that all users share where it should be."""

    directory: Path
    shared: bool  # by all users of this machine
    fault: str = ""

    @property
    def runs(self) -> Path:
        """Where runs under way announce themselves; nothing lies deeper where others could exchange a folder."""
        return self.directory if self.shared else self.directory / "runs"

    def windings(self, actuator: str) -> Path:
        """The file of one actuator's winding memory."""
        if self.shared:
            return self.directory / f"{actuator}.thermal.json"
        return self.directory / "thermal" / f"{actuator}.json"


def state_directory() -> Path:
    """The user's directory: `LEACTL_STATE`, else the state directory of the XDG specification.

    Raises
    ------
    InputError : there is neither, nor a home; `LEACTL_STATE` is relative, which would be another one in every folder.
    """
    named = os.environ.get("LEACTL_STATE")
    if named:
        return _absolute("LEACTL_STATE", named)
    xdg = os.environ.get("XDG_STATE_HOME", "")
    try:
        # the specification has relative paths ignored: they would be another directory in every folder
        return (Path(xdg) if Path(xdg).is_absolute() else Path.home() / ".local" / "state") / "leactl"
    except RuntimeError:
        raise InputError("there is no home directory for leactl's state; set LEACTL_STATE to a directory") from None


def of_user() -> Place:
    """Where a user's own state is kept."""
    return Place(state_directory(), shared=False)


def of_machine() -> Place:
    """Where the state of this machine's benches is kept for all users; the user's place and the reason where it cannot.

    `LEACTL_MACHINE_STATE` stands for /var/lib/leactl in tests of leactl itself.
    """
    directory = _machine_directory()
    fault = _made(directory)
    return Place(state_directory(), shared=False, fault=fault) if fault else Place(directory, shared=True)


def place_of(bench: "BenchFile", in_process: bool) -> Place:
    """Where the latch and the windings of a bench are kept.

    A bench that another process serves is met as a real one is, unless `LEACTL_STATE` keeps its rehearsals apart.
    """
    apart = bench.emulated is not None and bool(os.environ.get("LEACTL_STATE"))
    return of_user() if in_process or apart else of_machine()


def places() -> list[Place]:
    """Every place that may hold something to be read: the machine's, whether it can be written to or not, first."""
    return [Place(_machine_directory(), shared=True), of_user()]


def reachable() -> tuple[list[Place], list[str]]:
    """As `places`, for whoever must go on without those that cannot be; a line for each of these."""
    reached: list[Place] = []
    faults: list[str] = []
    for shared, directory in ((True, _machine_directory), (False, state_directory)):
        try:
            place = Place(directory(), shared)
        except InputError as error:
            faults.append(str(error))
            continue
        if os.path.lexists(place.runs) and not place.runs.is_dir():
            faults.append(f"{place.runs}: a directory of runs was expected; what runs there cannot be seen")
        else:
            reached.append(place)
    return reached, faults


def examine() -> "HostFinding":
    """Where locks, trip latches and winding memory of benches on real buses are, and whether all users share them."""
    from leactl.bench.host_checks import HostFinding

    directory = _machine_directory()
    locks = "locks in the kernel, shared by all users; trip latches and winding memory in"
    fault = _unusable(directory)
    if not fault and os.lstat(directory).st_mode & SHARED_DIRECTORY != SHARED_DIRECTORY:
        fault = f"{directory}: not every user can write there"
    if not fault or (not os.path.lexists(directory) and os.access(directory.parent, os.W_OK)):  # the first run makes it
        return HostFinding("state", True, False, f"{locks} {directory}, shared by all users")
    mend = f"sudo install -d -o root -m 1777 {shlex.quote(str(directory))}"
    kept = state_directory() if _unusable(directory) else directory
    return HostFinding("state", False, False, f"{locks} {kept}, this user's alone ({fault})", mend)


def read(path: Path) -> bytes:
    """What a regular file of state holds.

    Raises
    ------
    FileNotFoundError : there is none, and no link either.
    OSError : it is no regular file, a link, or larger than any file of state.
    """
    descriptor = os.open(path, os.O_RDONLY | NO_LINK | AT_ONCE | AS_BYTES)
    try:
        _expect_regular(descriptor, path)
        text = os.read(descriptor, MOST_BYTES + 1)
    finally:
        os.close(descriptor)
    if len(text) > MOST_BYTES:
        raise OSError(f"more than {MOST_BYTES} bytes")
    return text


def opened(path: Path, shared: bool) -> int:
    """Open a regular file of state for reading and writing, made where there is none.

    Raises
    ------
    OSError : it cannot be made, or is a link or no regular file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    how = os.O_RDWR | NO_LINK | AT_ONCE | AS_BYTES
    try:
        descriptor = os.open(path, how | os.O_CREAT | os.O_EXCL, OF_ITS_OWNER)
    except FileExistsError:
        # without O_CREAT: in a sticky directory the kernel refuses that for another user's file (fs.protected_regular)
        descriptor = os.open(path, how)
    else:
        if shared:  # on Linux alone
            os.fchmod(descriptor, OF_EVERYBODY)
    try:
        _expect_regular(descriptor, path)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def in_place(descriptor: int, path: Path) -> bool:
    """Whether an open file is still the one at its path: not removed, moved or exchanged; takes no descriptor."""
    try:
        there, own = os.lstat(path), os.fstat(descriptor)
    except OSError:
        return False
    return (there.st_dev, there.st_ino) == (own.st_dev, own.st_ino)


def _machine_directory() -> Path:
    return _absolute("LEACTL_MACHINE_STATE", os.environ.get("LEACTL_MACHINE_STATE") or MACHINE)


def _absolute(variable: str, named: str) -> Path:
    if not Path(named).is_absolute():
        raise InputError(f"{variable} is {named}: an absolute path was expected, for a relative one leads elsewhere")
    return Path(named)


def _made(directory: Path) -> str:
    """Make the shared directory where there is none; why it cannot be used, or nothing."""
    try:
        directory.mkdir()
        directory.chmod(SHARED_DIRECTORY)
    except FileExistsError:
        pass
    except OSError as error:
        return f"{directory}: cannot be made: {error.strerror}"
    return _unusable(directory)


def _unusable(directory: Path) -> str:
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
