"""Open regular files alone: a FIFO without a writer holds whoever opens it, a device such as /dev/zero never ends."""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO


def open_regular(path: Path, most: int | None = None) -> BinaryIO:
    """Open a regular file for reading bytes.

    Parameters
    ----------
    most : bytes that it may have.

    Raises
    ------
    OSError : it cannot be opened, is of another kind, or larger; `strerror` says so.
    """
    stream = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    about = os.fstat(stream.fileno())
    if stat.S_ISREG(about.st_mode) and (most is None or about.st_size <= most):
        return stream
    stream.close()
    if stat.S_ISDIR(about.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(about.st_mode):
        raise OSError(errno.EINVAL, "a regular file was expected; this is none", str(path))
    raise OSError(errno.EFBIG, f"{about.st_size} bytes; at most {most} are read", str(path))
