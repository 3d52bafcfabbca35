"""Open regular files alone: a FIFO without a writer holds whoever opens it, a device such as /dev/zero never ends.

What only POSIX has is left out on other systems, where files are read and benches are emulated.
"""

import errno
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Final

from leactl.errors import InputError

NO_LINK: Final = getattr(os, "O_NOFOLLOW", 0)
AT_ONCE: Final = getattr(os, "O_NONBLOCK", 0)
OF_THIS_PROCESS: Final = getattr(os, "O_CLOEXEC", 0) or getattr(os, "O_NOINHERIT", 0)
AS_BYTES: Final = getattr(os, "O_BINARY", 0)  # Windows writes other line ends without it


def open_regular(path: Path, most: int | None = None) -> BinaryIO:
    """Open a regular file for reading bytes.

    Parameters
    ----------
    most : bytes that it may have.

    Raises
    ------
    OSError : it cannot be opened, is of another kind, or larger; `strerror` says so.
    """
    stream = os.fdopen(os.open(path, os.O_RDONLY | AT_ONCE | OF_THIS_PROCESS | AS_BYTES), "rb")
    about = os.fstat(stream.fileno())
    if stat.S_ISREG(about.st_mode) and (most is None or about.st_size <= most):
        return stream
    stream.close()
    if stat.S_ISDIR(about.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(about.st_mode):
        raise OSError(errno.EINVAL, "a regular file was expected; this is none", str(path))
    raise OSError(errno.EFBIG, f"{about.st_size} bytes; at most {most} are read", str(path))


def is_being_written(path: Path) -> bool:
    """Return whether a process of this machine is seen to have a file open for writing.

    It is looked up under /proc, which shows a user's own processes: HDF5's lock is no help, since a writer that others
    may read along gives it up, and network file systems refuse a lease whoever writes.
    """
    try:
        about = path.stat()
        processes = [entry for entry in Path("/proc").iterdir() if entry.name.isdecimal()]
    except OSError:
        return False
    for process in processes:
        with suppress(OSError):  # it has ended, or is another user's
            if any(_writes(process, descriptor, about) for descriptor in (process / "fd").iterdir()):
                return True
    return False


def _writes(process: Path, descriptor: Path, about: os.stat_result) -> bool:
    try:
        if not os.path.samestat(descriptor.stat(), about):
            return False
        told = (process / "fdinfo" / descriptor.name).read_text(encoding="ascii")
    except OSError:  # it was closed meanwhile
        return False
    flags = next((line.split()[1] for line in told.splitlines() if line.startswith("flags:")), "0")
    return int(flags, 8) & os.O_ACCMODE != os.O_RDONLY


def file_bytes(path: Path, most: int | None = None, count: int = -1) -> bytes:
    """Read a regular file that a person named.

    Parameters
    ----------
    most : largest size of the file [bytes].
    count : bytes that are read; -1 reads the whole file.

    Raises
    ------
    InputError : it cannot be opened, is no regular file, or is larger than `most`; in one line.
    """
    try:
        with open_regular(path, most) as stream:
            return stream.read(count)
    except OSError as fault:
        raise InputError(f"{path}: {fault.strerror or fault}") from None
    except ValueError as fault:  # a path may hold characters that no file name can
        raise InputError(f"{str(path)!r}: {fault}") from None


def read_at(descriptor: int, count: int, place: int) -> bytes:
    """Read bytes at a place of a file, wherever it stands."""
    if hasattr(os, "pread"):
        return os.pread(descriptor, count, place)
    os.lseek(descriptor, place, os.SEEK_SET)
    return os.read(descriptor, count)


def write_at(descriptor: int, data: bytes, place: int) -> int:
    """Write bytes at a place of a file, wherever it stands; how many of them were."""
    if hasattr(os, "pwrite"):
        return os.pwrite(descriptor, data, place)
    os.lseek(descriptor, place, os.SEEK_SET)
    return os.write(descriptor, data)
