"""Checks that output files and folders can be written, before a computation that takes minutes."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from leactl.errors import InputError


def check_files(files: Sequence[Path], inputs: Sequence[Path], other_faults: Sequence[str] = ()) -> None:
    """Raise if an output file cannot be written; an existing file may be replaced, but not an input.

    Parameters
    ----------
    other_faults : faults that are reported with those of the files.

    Raises
    ------
    InputError : a file is an input, not a plain file, or named twice, or its folder is absent or cannot be written to.
    """
    input_files = {path.resolve() for path in inputs}
    faults = [f"{path}: is an input; name another file" for path in files if path.resolve() in input_files]
    faults += [f"{path}: {reason}" for path in files if (reason := _output_fault(path))]
    resolved_paths = [path.resolve() for path in files]
    repeated_files = {path for path in files if resolved_paths.count(path.resolve()) > 1}
    faults += [f"{path}: is named for two outputs; give each a file of its own" for path in sorted(repeated_files)]
    faults += other_faults
    if faults:
        raise InputError(faults)


def _output_fault(path: Path) -> str:
    """Return the reason why an output file cannot be written; empty if there is none."""
    try:
        if path.exists() and not path.is_file():
            return "is no plain file"
        if not path.parent.is_dir():
            return f"no folder {path.parent}"
    except PermissionError as error:  # a folder above it may not be searched
        return f"cannot be written: {error.strerror}"
    reason = write_fault(path.parent)
    return f"cannot be written: {reason}" if reason else ""


def check_folder(folder: Path) -> None:
    """Raise if a folder cannot be made, or if no file can be written to it.

    Raises
    ------
    InputError : the folder cannot be made or written to; the line names the part of its path that prevents it.
    """
    nearest_existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(path))
    if reason := write_fault(nearest_existing) if nearest_existing.is_dir() else "not a folder":
        raise InputError(f"{folder}: cannot be made or written to: {nearest_existing}: {reason}; choose another --out")


def write_fault(folder: Path) -> str:
    """Return the reason why no file can be written to a folder; empty if a file can be, or if there is no such folder.

    A temporary file is written to find out, since the disk may be mounted read-only.
    """
    if not folder.is_dir():
        return ""  # the callers report an absent folder
    try:
        with tempfile.TemporaryFile(dir=folder):
            return ""
    except OSError as error:
        return error.strerror or str(error)
