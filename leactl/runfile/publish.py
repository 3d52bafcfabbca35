"""Publish a finished file in one step, so that no reader ever sees a partial file.

The file is written under a hidden name in the same directory, forced to the disk and then renamed.
"""

import errno
import os
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from leactl.errors import InputError

# numbers of errors of a disk that is full, damaged or read-only
DISK_FAULTS: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}


class NotWritten(InputError):
    """A file could not be written; a file of that name that existed before is unchanged."""


@contextmanager
def new_file(target: Path) -> Iterator[Path]:
    """Yield a temporary path; the file written there becomes `target`, which must not exist yet."""
    refuse_existing(target)
    with temporary(target) as path:
        yield path
        with _reported_for(target):
            force_to_disk(path)
            move_without_overwriting(path, target)


@contextmanager
def replacement(target: Path) -> Iterator[Path]:
    """Yield a temporary path; the file written there replaces `target` in one step or not at all."""
    with temporary(target) as path:
        yield path
        with _reported_for(target):
            force_to_disk(path)
            path.replace(target)
        force_folder_to_disk(target.parent)


def refuse_existing(target: Path) -> None:
    """Raise InputError if the path exists: no file is ever overwritten."""
    if os.path.lexists(target):
        raise InputError(f"{target}: exists already and is never overwritten; choose another name or move it away")


def move_without_overwriting(source: Path, target: Path) -> None:
    """Rename a file without overwriting; a hard link makes the check and the rename one step.

    Raises
    ------
    InputError : the target exists.
    """
    try:
        os.link(source, target)
    except FileExistsError:
        refuse_existing(target)
        raise
    except OSError:  # no hard links here (exFAT, some network mounts): the check and the rename are two steps
        refuse_existing(target)
        source.rename(target)
    else:
        source.unlink()
    force_folder_to_disk(target.parent)


@contextmanager
def temporary(target: Path) -> Iterator[Path]:
    """Yield an unused hidden path in the target's folder, and remove the file there at the end.

    Raises
    ------
    NotWritten : the block failed with an OSError; the message says that the target cannot be written if the error
        names it or is that of a disk, and else that it was not written.
    """
    path = target.with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    try:
        yield path
    except OSError as fault:
        # a failed write has no file name, and neither has a failed read; errno identifies a disk that cannot be written
        is_write_failure = str(fault.filename) in (str(path), str(target)) or (
            fault.filename is None and fault.errno in DISK_FAULTS
        )
        raise _not_written(target, "cannot be" if is_write_failure else "was not", fault) from fault
    finally:
        with suppress(OSError):  # an earlier error must not be replaced by this one
            path.unlink()


@contextmanager
def _reported_for(target: Path) -> Iterator[None]:
    """Convert an OSError in the block to NotWritten, with the target as the file that cannot be written."""
    try:
        yield
    except OSError as fault:
        raise _not_written(target, "cannot be", fault) from fault


def _not_written(target: Path, verb: str, fault: OSError) -> NotWritten:
    """Return an error of one line that ends with the text of `fault`."""
    return NotWritten(f"{target}: {verb} written: {' '.join(str(fault).split())}")


def force_folder_to_disk(folder: Path) -> None:
    """Wait until the entries of a folder are on the disk, if its file system supports that.

    Some network mounts refuse the request, and Windows cannot open a folder. That is no failure, since the file already
    has its final name.
    """
    if sys.platform != "win32":
        with suppress(OSError):
            force_to_disk(folder)


def force_to_disk(path: Path) -> None:
    """Wait until a file, or the entries of a folder, are on the disk (fsync).

    Windows requires a descriptor that is open for writing.
    """
    descriptor = os.open(path, os.O_RDWR if sys.platform == "win32" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
