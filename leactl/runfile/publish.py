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

DISK_FAULTS: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}


class NotWritten(InputError):
    """A file could not be written; a file of that name that existed before is unchanged."""


@contextmanager
def new_file(target: Path) -> Iterator[Path]:
    """Yield a temporary path; the file written there becomes `target`, which must not exist yet."""
    refuse_existing(target)
    with temporary(target) as path:
        yield path
        with _blamed_on(target):
            force_to_disk(path)
            move_without_overwriting(path, target)


@contextmanager
def replacement(target: Path) -> Iterator[Path]:
    """Yield a temporary path; the file written there replaces `target` in one step or not at all."""
    with temporary(target) as path:
        yield path
        with _blamed_on(target):
            force_to_disk(path)
            path.replace(target)
        force_folder_to_disk(target.parent)


def refuse_existing(target: Path) -> None:
    """Raise InputError if the path exists: no file is ever overwritten."""
    if os.path.lexists(target):
        raise InputError(f"{target}: exists already and is never overwritten; choose another name or move it away")


def move_without_overwriting(source: Path, target: Path) -> None:
    """Rename a file; raises InputError if the target exists. A hard link makes check and rename one step."""
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
    """Yield an unused hidden path next to the target, and remove the file there at the end.

    Raises
    ------
    NotWritten : the block failed with an OSError; the target is blamed only where the system blames it or the disk.
    """
    path = target.with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    try:
        yield path
    except OSError as fault:
        # a write that failed names no file, and so does a read; the system's number tells a disk that takes no more
        is_of_target = str(fault.filename) in (str(path), str(target)) or (
            fault.filename is None and fault.errno in DISK_FAULTS
        )
        raise _not_written(target, "cannot be" if is_of_target else "was not", fault) from fault
    finally:
        with suppress(OSError):  # what went wrong before is what is told
            path.unlink()


@contextmanager
def _blamed_on(target: Path) -> Iterator[None]:
    """Convert an OSError of forcing a finished file to the disk and naming it."""
    try:
        yield
    except OSError as fault:
        raise _not_written(target, "cannot be", fault) from fault


def _not_written(target: Path, verb: str, fault: OSError) -> NotWritten:
    """The error of one line, with the words of the system."""
    return NotWritten(f"{target}: {verb} written: {' '.join(str(fault).split())}")


def force_folder_to_disk(folder: Path) -> None:
    """Wait until the entries of a folder are on the disk, where its file system can be asked for that.

    Some network mounts refuse it, and Windows opens no folder. The file has its name by then: it is no failure.
    """
    if sys.platform != "win32":
        with suppress(OSError):
            force_to_disk(folder)


def force_to_disk(path: Path) -> None:
    """Wait until a file, or what a folder lists, is on the disk (fsync); Windows wants a descriptor that may write."""
    descriptor = os.open(path, os.O_RDWR if sys.platform == "win32" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
