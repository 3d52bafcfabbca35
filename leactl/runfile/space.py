"""Take disk space before HDF5 asks for it, so that a full disk is an error here and not a crash there.

A write that fails inside HDF5 leaves its cache inconsistent and the process dies with a segmentation fault when the
file is closed (seen with HDF5 2.0); in the middle of a run that would leave a bench without its control loop.
"""

import errno
import os
import shutil
from pathlib import Path
from typing import Any

RESERVE = 1 << 20  # HDF5's own tables, some kB a column, and then some
END_OF_FILE = slice(28, 36)  # in superblock versions 2 and 3 (HDF5 file format 3.0, II.A)


def reserve(file: Any, size: int) -> None:
    """Have room for so many bytes more, or raise OSError with the file as it was."""
    descriptor = file.id.get_vfd_handle()
    have = os.fstat(descriptor).st_size
    lacking = file.id.get_filesize() + size + RESERVE - have
    if lacking <= 0:
        return
    try:
        os.posix_fallocate(descriptor, have, lacking)
    except OSError as fault:
        if fault.errno not in (errno.EOPNOTSUPP, errno.EINVAL):
            raise OSError(fault.errno, f"no room for {lacking} bytes more: {fault.strerror}") from fault
        # a file system that cannot reserve can at least count
        free = shutil.disk_usage(Path(file.filename).parent).free
        if free < lacking:
            raise OSError(errno.ENOSPC, f"no room for {lacking} bytes more: {free} are free") from fault


def trim(path: Path) -> None:
    """Give back what was reserved and not used, after the file is closed."""
    with path.open("r+b") as raw:
        end = int.from_bytes(raw.read(END_OF_FILE.stop)[END_OF_FILE], "little")
        if 0 < end < os.fstat(raw.fileno()).st_size:
            raw.truncate(end)
