"""Open a run file at the door: say in one line why it is none, or hand over an open HDF5 file.

A file left by a kill, or one still being written, opens only in HDF5's SWMR reading mode; a foreign or cut file never.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from leactl.errors import InputError
from leactl.regular import open_regular
from leactl.runfile import layout
from leactl.runfile.heaps import endless_heaps
from leactl.runfile.tree import attribute_bytes, faults_of_attributes, faults_of_tree
from leactl.yamlfile import shown

TOO_NEW = (
    f"written in a newer HDF5 format than h5py {h5py.__version__} with HDF5 {h5py.version.hdf5_version} reads; where it"
    " opens, `leactl runs convert` makes it old again"
)
# h5py meets a spoiled header with any of these: a type without a NumPy one is TypeError, a wrong length ValueError
DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError)
SIGNATURE = b"\x89HDF\r\n\x1a\n"
# Byte 11 of superblock version 3: bit 0, a writer has it open; bit 2, it writes in SWMR mode (HDF5 file format 3.0)
FLAGS_AT, OPEN_FOR_WRITE, SWMR_WRITE = 11, 0x01, 0x04


def open_run_file(path: Path, root: dict[str, Any] | None = None) -> tuple[Any, bool]:
    """Open a run file for reading; says whether a writer has it open or was killed while it had.

    Its attributes are read here in any case: they are added to `root`, where that is given.
    """
    try:
        with open_regular(path) as raw:
            head = raw.read(FLAGS_AT + 1)
            endless = endless_heaps(raw) if head.startswith(SIGNATURE) and len(head) > FLAGS_AT else []
    except IsADirectoryError:
        raise InputError(f"{path}: a folder; run files were expected, such as {path / '*.h5'}") from None
    except OSError as fault:
        raise InputError(f"{path}: cannot be read: {fault.strerror}") from fault
    flags = head[FLAGS_AT] if head.startswith(SIGNATURE) and len(head) > FLAGS_AT and head[8] >= 3 else 0
    if flags & OPEN_FOR_WRITE and not flags & SWMR_WRITE:
        raise InputError(f"{path}: the recording never started (its writer ended while preparing the file); delete it")
    if endless:
        raise InputError(f"{path}: damaged: the texts that begin at byte {endless[0]} are not whole")
    live = bool(flags & SWMR_WRITE)
    try:
        if live:
            refuse_spoiled_head(path)
        file = h5py.File(path, "r", swmr=live)
    except DAMAGE as fault:
        raise InputError(f"{path}: {why(fault)}") from fault
    try:
        faults = faults_of_root(file, {} if root is None else root) or faults_of_tree(file)
    except DAMAGE as fault:
        faults = [damage(fault)]
    if faults:
        file.close()
        raise InputError([f"{path}: {fault}" for fault in faults])
    return file, live


def refuse_spoiled_head(path: Path) -> None:
    """Raise OSError where the superblock is spoiled: in SWMR mode HDF5 would wait for a writer to mend it, for ever."""
    try:
        h5py.File(path, "r").close()
    except OSError as fault:
        if "checksum" in str(fault):  # else that it is open for writing, as is known
            raise


@contextmanager
def reading(path: Path, place: str = "") -> Iterator[None]:
    """Turn what HDF5 says of damaged data into one line with file and place."""
    try:
        yield
    except DAMAGE as fault:
        where = f"{path}: {place}" if place else f"{path}"
        raise InputError(f"{where}: {damage(fault)}") from fault


def damage(fault: Exception) -> str:
    """What HDF5 says of data that it cannot read, in words a person can act on."""
    if isinstance(fault, MemoryError):
        return "holds more than fits into the memory of this computer"
    text = " ".join(str(fault).split())
    return TOO_NEW if "bad version number" in text else f"damaged: {text}"


def why(fault: Exception) -> str:
    """HDF5's reason in words a person can act on."""
    text = str(fault)
    if "signature not found" in text:
        return "not an HDF5 file"
    if "truncated" in text:
        return "truncated: the file is shorter than it says; copy it again from where it was recorded"
    return f"HDF5 cannot open it: {' '.join(text.split())}"


def faults_of_root(file: Any, root: dict[str, Any]) -> list[str]:
    """Whether the file is a run of a version that this program reads; adds its attributes to `root`."""
    try:
        if faults := faults_of_attributes(attribute_bytes(file.id), "/"):
            return faults
        root |= layout.attributes(file)
    except DAMAGE as fault:
        return [f"its attributes cannot be read: {damage(fault)}"]
    if root.get("format") != layout.FORMAT:
        return [f"not a run file: attribute 'format' is {shown(root.get('format'))}, expected {layout.FORMAT!r}"]
    if root.get("format_version") != layout.VERSION:
        return [f"format_version is {shown(root.get('format_version'))}; this program reads {layout.VERSION}"]
    return []
