"""Reserve disk space before HDF5 writes, so that a full disk raises an error here instead of crashing HDF5.

A write that fails inside HDF5 leaves its cache inconsistent, and the process dies with a segmentation fault when the
file is closed (seen with HDF5 2.0). During a run, that would leave a bench without its control loop.
"""

import errno
import os
import shutil
from pathlib import Path
from typing import Any

RESERVE = 1 << 20  # bytes in addition to the data, for HDF5's internal tables of some kB per column
# byte range of the end-of-file address in each version of the superblock (HDF5 file format 3.0, II.A)
END_OF_FILE = {0: slice(40, 48), 2: slice(28, 36), 3: slice(28, 36)}
VERSION_AT, OFFSET_SIZE_AT = 8, {0: 13, 2: 9, 3: 9}


def reserve(file: Any, size: int) -> None:
    """Reserve disk space for `size` more bytes.

    Raises
    ------
    OSError : there is no room on the disk; the file is as it was.
    """
    descriptor = file.id.get_vfd_handle()
    file_size = os.fstat(descriptor).st_size
    missing_bytes = file.id.get_filesize() + size + RESERVE - file_size
    if missing_bytes <= 0:
        return
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(descriptor, file_size, missing_bytes)
            return
    except OSError as fault:
        if fault.errno not in (errno.EOPNOTSUPP, errno.EINVAL):
            raise OSError(fault.errno, f"no room for {missing_bytes} bytes more: {fault.strerror}") from fault
    # where the system cannot reserve space, the free space of the disk is checked instead
    free_bytes = shutil.disk_usage(Path(file.filename).parent).free
    if free_bytes < missing_bytes:
        raise OSError(errno.ENOSPC, f"no room for {missing_bytes} bytes more: {free_bytes} are free")


def trim(path: Path) -> None:
    """Release reserved space that was not used, after the file is closed."""
    with path.open("r+b") as raw:
        superblock = raw.read(48)
        version = superblock[VERSION_AT]
        if version not in END_OF_FILE or superblock[OFFSET_SIZE_AT[version]] != 8:
            return  # the reserved space stays, which wastes space and does no other harm
        end = int.from_bytes(superblock[END_OF_FILE[version]], "little")
        if 0 < end < os.fstat(raw.fileno()).st_size:
            raw.truncate(end)
