"""Open a run file at the door: say in one line why it is none, or hand over an open HDF5 file.

A file left by a kill, or one still being written, opens only in HDF5's SWMR reading mode; a foreign or cut file never.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from leactl.errors import InputError
from leactl.runfile import layout

TOO_NEW = (
    f"written in a newer HDF5 format than h5py {h5py.__version__} with HDF5 {h5py.version.hdf5_version} reads; where it"
    " opens, `leactl runs convert` makes it old again"
)
SIGNATURE = b"\x89HDF\r\n\x1a\n"
# Byte 11 of superblock version 3: bit 0, a writer has it open; bit 2, it writes in SWMR mode (HDF5 file format 3.0)
FLAGS_AT, OPEN_FOR_WRITE, SWMR_WRITE = 11, 0x01, 0x04


def open_run_file(path: Path) -> tuple[Any, bool]:
    """Open a run file for reading; says whether a writer has it open or was killed while it had."""
    try:
        with path.open("rb") as raw:
            head = raw.read(FLAGS_AT + 1)
    except IsADirectoryError:
        raise InputError(f"{path}: a folder; run files were expected, such as {path / '*.h5'}") from None
    except OSError as fault:
        raise InputError(f"{path}: cannot be read: {fault.strerror}") from fault
    flags = head[FLAGS_AT] if head.startswith(SIGNATURE) and len(head) > FLAGS_AT and head[8] >= 3 else 0
    if flags & OPEN_FOR_WRITE and not flags & SWMR_WRITE:
        raise InputError(f"{path}: the recording never started (its writer ended while preparing the file); delete it")
    live = bool(flags & SWMR_WRITE)
    try:
        file = h5py.File(path, "r", swmr=live)
    except OSError as fault:
        raise InputError(f"{path}: {why(fault)}") from fault
    if faults := faults_of_root(file):
        file.close()
        raise InputError([f"{path}: {fault}" for fault in faults])
    return file, live


@contextmanager
def reading(path: Path, place: str = "") -> Iterator[None]:
    """Turn what HDF5 says of damaged data into one line with file and place."""
    try:
        yield
    except (OSError, RuntimeError, KeyError) as fault:
        where = f"{path}: {place}" if place else f"{path}"
        raise InputError(f"{where}: {damage(fault)}") from fault


def damage(fault: Exception) -> str:
    """What HDF5 says of data that it cannot read, in words a person can act on."""
    text = " ".join(str(fault).split())
    return TOO_NEW if "bad version number" in text else f"damaged: {text}"


def why(fault: OSError) -> str:
    """HDF5's reason in words a person can act on."""
    text = str(fault)
    if "signature not found" in text:
        return "not an HDF5 file"
    if "truncated" in text:
        return "truncated: the file is shorter than it says; copy it again from where it was recorded"
    return f"HDF5 cannot open it: {' '.join(text.split())}"


def faults_of_root(file: Any) -> list[str]:
    """Whether the file is a run of a version that this program reads."""
    try:
        root = layout.attributes(file)
    except (OSError, RuntimeError, KeyError) as fault:
        return [f"its attributes cannot be read: {fault}"]
    if root.get("format") != layout.FORMAT:
        return [f"not a run file: attribute 'format' is {root.get('format')!r}, expected {layout.FORMAT!r}"]
    if root.get("format_version") != layout.VERSION:
        return [f"format_version is {root.get('format_version')!r}; this program reads {layout.VERSION}"]
    return []


def faults_of_links(node: Any, place: str = "") -> list[str]:
    """Links that lead out of the file and datasets whose values lie elsewhere or cannot be decoded."""
    faults = []
    for name in node:
        path = f"{place}/{name}"
        if not isinstance(node.get(name, getlink=True), h5py.HardLink):
            faults.append(f"{path}: a link instead of data; a run file holds everything itself")
            continue
        child = node[name]
        if isinstance(child, h5py.Group):
            faults += faults_of_links(child, path)
        elif isinstance(child, h5py.Dataset):
            if child.is_virtual or child.external:
                faults.append(f"{path}: its values lie in another file; a run file holds everything itself")
            faults += [f"{path}: filter {code} is neither gzip nor shuffle" for code in filters(child) - KNOWN_FILTERS]
    return faults


KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}


def filters(dataset: Any) -> set[int]:
    """Codes of the filters that a dataset passes through."""
    plist = dataset.id.get_create_plist()
    return {plist.get_filter(index)[0] for index in range(plist.get_nfilters())}
