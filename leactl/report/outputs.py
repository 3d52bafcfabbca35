"""Files that an answer goes to: found fault with all at once, before minutes are spent on what could not be written."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from leactl.errors import InputError


def check(files: Sequence[Path], inputs: Sequence[Path], also: Sequence[str] = ()) -> None:
    """Refuse what could not be written; an earlier answer of the same name is replaced, what was read never is.

    Parameters
    ----------
    also : faults found before.

    Raises
    ------
    InputError : a file is an input or no plain file, its folder does not exist or takes none, or one is named twice.
    """
    read = {path.resolve() for path in inputs}
    faults = [f"{path}: is an input; name another file" for path in files if path.resolve() in read]
    faults += [f"{path}: is no plain file" for path in files if path.exists() and not path.is_file()]
    faults += [f"{path}: no folder {path.parent}" for path in files if not path.parent.is_dir()]
    faults += [f"{path}: cannot be written: {why}" for path in files if (why := refusal(path.parent))]
    twice = {path for path in files if sum(path.resolve() == other.resolve() for other in files) > 1}
    faults += [f"{path}: is named for two outputs; give each a file of its own" for path in sorted(twice)]
    faults += also
    if faults:
        raise InputError(faults)


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be made or takes no file.

    Raises
    ------
    InputError : with the part of its path that is why.
    """
    there = next(path for path in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(path))
    if why := refusal(there) if there.is_dir() else "not a folder":
        raise InputError(f"{folder}: cannot be made or written to: {there}: {why}; choose another --out")


def refusal(folder: Path) -> str:
    """Why a folder takes no file, by trying: rights alone do not tell of a disk that is mounted read-only."""
    if not folder.is_dir():
        return ""  # another fault
    try:
        with tempfile.TemporaryFile(dir=folder):
            return ""
    except OSError as fault:
        return fault.strerror or str(fault)
