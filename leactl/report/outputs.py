"""Checks of output files and folders, before minutes are spent on results that could not be written."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from leactl.errors import InputError


def check_files(files: Sequence[Path], inputs: Sequence[Path], other_faults: Sequence[str] = ()) -> None:
    """Refuse output files that cannot be written; an existing file may be replaced, but never an input.

    Parameters
    ----------
    other_faults : faults that are reported with those of the files.

    Raises
    ------
    InputError : a file is an input or no plain file, its folder does not exist or takes none, or one is named twice.
    """
    read_files = {path.resolve() for path in inputs}
    faults = [f"{path}: is an input; name another file" for path in files if path.resolve() in read_files]
    faults += [f"{path}: is no plain file" for path in files if path.exists() and not path.is_file()]
    faults += [f"{path}: no folder {path.parent}" for path in files if not path.parent.is_dir()]
    faults += [f"{path}: cannot be written: {reason}" for path in files if (reason := refusal(path.parent))]
    twice = {path for path in files if sum(path.resolve() == other.resolve() for other in files) > 1}
    faults += [f"{path}: is named for two outputs; give each a file of its own" for path in sorted(twice)]
    faults += other_faults
    if faults:
        raise InputError(faults)


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be made or takes no file.

    Raises
    ------
    InputError : the folder cannot be made or written to; the line names the part of its path that prevents it.
    """
    existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(path))
    if reason := refusal(existing) if existing.is_dir() else "not a folder":
        raise InputError(f"{folder}: cannot be made or written to: {existing}: {reason}; choose another --out")


def refusal(folder: Path) -> str:
    """Return the reason why a folder takes no file; empty if it takes one.

    A temporary file is written, since a disk may be mounted read-only.
    """
    if not folder.is_dir():
        return ""  # reported as another fault
    try:
        with tempfile.TemporaryFile(dir=folder):
            return ""
    except OSError as fault:
        return fault.strerror or str(fault)
