"""Open and read regular files only: to open a FIFO waits for its writer, and a device such as /dev/zero never ends.

It also tells whether a file is being written, and reads and writes at an offset.

Flags that only POSIX has are 0 on other systems, on which leactl reads files and emulates benches.
"""

import errno
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Final

from leactl.errors import InputError

# flags of `os.open`
NOFOLLOW: Final = getattr(os, "O_NOFOLLOW", 0)
NONBLOCK: Final = getattr(os, "O_NONBLOCK", 0)
CLOEXEC: Final = getattr(os, "O_CLOEXEC", 0) or getattr(os, "O_NOINHERIT", 0)  # no child inherits the file
BINARY: Final = getattr(os, "O_BINARY", 0)  # without it, Windows converts line ends


def open_regular(path: Path, most_bytes: int | None = None) -> BinaryIO:
    """Open a regular file for reading bytes.

    Parameters
    ----------
    most_bytes : largest size of the file; None for no limit.

    Raises
    ------
    OSError : the file cannot be opened, is not a regular file, or is too large; `strerror` has the reason.
    """
    descriptor = os.open(path, os.O_RDONLY | NONBLOCK | CLOEXEC | BINARY)
    status = os.fstat(descriptor)
    if stat.S_ISREG(status.st_mode) and (most_bytes is None or status.st_size <= most_bytes):
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "a regular file was expected; this is none", str(path))
    raise OSError(errno.EFBIG, f"{status.st_size} bytes; at most {most_bytes} are read", str(path))


def is_being_written(path: Path) -> bool:
    """Return whether a process of this machine has a file open for writing, as far as /proc shows it.

    /proc shows the open files of a user's own processes. HDF5's lock does not help, since a writer in SWMR mode
    releases it, and a file lease does not either, since network file systems refuse leases whether or not a file is
    written.
    """
    try:
        status = path.stat()
        processes = [entry for entry in Path("/proc").iterdir() if entry.name.isdecimal()]
    except OSError:
        return False
    for process in processes:
        with suppress(OSError):  # the process has ended, or is another user's
            if any(_descriptor_writes(process, descriptor, status) for descriptor in (process / "fd").iterdir()):
                return True
    return False


def _descriptor_writes(process: Path, descriptor: Path, status: os.stat_result) -> bool:
    """Return whether a descriptor of a process is open for writing to the file with this status."""
    try:
        if not os.path.samestat(descriptor.stat(), status):
            return False
        descriptor_info = (process / "fdinfo" / descriptor.name).read_text(encoding="ascii")
    except OSError:  # the descriptor was closed meanwhile
        return False
    flags = next((line.split()[1] for line in descriptor_info.splitlines() if line.startswith("flags:")), "0")
    return int(flags, 8) & os.O_ACCMODE != os.O_RDONLY


def file_bytes(path: Path, most_bytes: int | None = None, count: int = -1) -> bytes:
    """Read a regular file; faults are messages for the person who named it.

    Parameters
    ----------
    most_bytes : largest size of the file; None for no limit.
    count : number of bytes to read; -1 reads the whole file.

    Raises
    ------
    InputError : the file cannot be opened, is not a regular file, or is larger than `most_bytes`; the message is one
        line.
    """
    try:
        with open_regular(path, most_bytes) as stream:
            return stream.read(count)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:  # a path may hold characters that no file name can
        raise InputError(f"{str(path)!r}: {error}") from None


def read_at(descriptor: int, count: int, offset: int) -> bytes:
    """Read up to `count` bytes at an offset of a file, whatever its present position."""
    if hasattr(os, "pread"):
        return os.pread(descriptor, count, offset)
    os.lseek(descriptor, offset, os.SEEK_SET)
    return os.read(descriptor, count)


def write_at(descriptor: int, data: bytes, offset: int) -> int:
    """Write bytes at an offset of a file, whatever its present position, and return the number of bytes written."""
    if hasattr(os, "pwrite"):
        return os.pwrite(descriptor, data, offset)
    os.lseek(descriptor, offset, os.SEEK_SET)
    return os.write(descriptor, data)
