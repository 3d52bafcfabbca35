"""Open a run file at the door: say in one line why it is none, or hand over an open HDF5 file.

A file left by a kill, or one still being written, opens only in HDF5's SWMR reading mode; a foreign or cut file never.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import h5py

from leactl.errors import InputError
from leactl.regular import open_regular
from leactl.runfile import layout
from leactl.runfile.hdf5.swmr import FLAGS_AT, OPEN_FOR_WRITE, SIGNATURE, SWMR_WRITE, VERSION_AT, AsClosed
from leactl.runfile.hdf5.text_heaps import longest_text
from leactl.runfile.hdf5.tree import (
    MOST_ATTRIBUTES,
    MOST_NAMES,
    Node,
    attribute_bytes,
    faults_of_attributes,
    faults_of_foreign_tree,
    faults_of_texts_in_attributes,
    faults_of_tree,
)
from leactl.yamlfile import shown

TOO_NEW = (
    f"written in a newer HDF5 format than h5py {h5py.__version__} with HDF5 {h5py.version.hdf5_version} reads; where it"
    " opens, `leactl runs convert` makes it old again"
)
# h5py meets a spoiled header with any of these: a type without a NumPy one is TypeError, a wrong length ValueError
DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError)
GROWING = 3  # times that a live file is opened anew where it grew meanwhile
BEYOND_ITS_END = "addr overflow"  # what HDF5 calls a place behind the end that a file had when it was opened
USUAL_SIZES = (8, 8)  # bytes of addresses and of lengths


def open_run_file(path: Path, root: dict[str, Any] | None = None, values: bool = True) -> tuple[Any, bool]:
    """Open a run file for reading; says whether a writer has it open or was killed while it had.

    Parameters
    ----------
    root : gets the attributes of the root, which are read here in any case.
    values : whether more values will be read than the last of each stream, by `packing.last_value`.

    Raises
    ------
    InputError : not a run file, or one that cannot be read safely; one line for each fault.
    """
    try:
        raw = open_regular(path)
    except IsADirectoryError:
        raise InputError(f"{path}: a folder; run files were expected, such as {path / '*.h5'}") from None
    except OSError as fault:
        raise InputError(f"{path}: cannot be read: {fault.strerror}") from fault
    with raw:
        head = raw.read(FLAGS_AT + 1)
        flags = head[FLAGS_AT] if is_hdf5(head) and len(head) > FLAGS_AT and head[VERSION_AT] >= 3 else 0
        if flags & OPEN_FOR_WRITE and not flags & SWMR_WRITE:
            text = "the recording never started (its writer ended while preparing the file); delete it"
            raise InputError(f"{path}: {text}")
        live = bool(flags & SWMR_WRITE)
        for tries in range(GROWING, -1, -1):
            try:
                file = h5py.File(AsClosed(raw) if live else path, "r")
            except DAMAGE as fault:
                raise InputError(f"{path}: {open_failure(fault)}") from fault
            try:
                faults = faults_of_form(file, head) or faults_of_file(file, raw, {} if root is None else root, values)
            except DAMAGE as fault:
                faults = [damage_text(fault)]
            if faults:
                file.close()
            if not (tries and live and any(BEYOND_ITS_END in fault for fault in faults)):
                break
        if faults:
            raise InputError([f"{path}: {fault}" for fault in faults])
    return file, live


def open_foreign(path: Path) -> Any:
    """Open an HDF5 file that is no run for reading, such as a MAT file of version 7.3.

    Raises
    ------
    InputError : not an HDF5 file, or one that cannot be read safely; one line for each fault.
    """
    try:
        raw = open_regular(path)
    except OSError as fault:
        raise InputError(f"{path}: cannot be read: {fault.strerror}") from fault
    with raw:
        try:
            file = h5py.File(path, "r")
        except DAMAGE as fault:
            raise InputError(f"{path}: {open_failure(fault)}") from fault
        try:
            faults = faults_of_sizes(file) or faults_of_foreign_tree(file, raw, longest_text(raw))
        except InputError as fault:
            faults = fault.faults
        except DAMAGE as fault:
            faults = [damage_text(fault)]
        if faults:
            file.close()
            raise InputError([f"{path}: {fault}" for fault in faults])
    return file


def is_hdf5(head: bytes) -> bool:
    """Whether a file begins as HDF5."""
    return head.startswith(SIGNATURE)


def faults_of_form(file: Any, head: bytes) -> list[str]:
    """Whether HDF5's own structures begin with the first byte and are of the usual sizes."""
    if not is_hdf5(head):
        return ["begins with bytes that are not HDF5's; none were expected before its part"]
    return faults_of_sizes(file)


def faults_of_sizes(file: Any) -> list[str]:
    """Whether its texts can be looked through, whose heaps are of the usual sizes."""
    if (sizes := file.id.get_create_plist().get_sizes()) != USUAL_SIZES:
        return [f"its addresses and lengths have {sizes[0]} and {sizes[1]} bytes; 8 were expected"]
    return []


def faults_of_file(file: Any, raw: BinaryIO, root: dict[str, Any], values: bool) -> list[str]:
    """Whether the file is a run, and everything that makes it unfit to be read; adds its attributes to `root`."""
    try:
        longest = longest_text(raw)
        return faults_of_root(file, longest, root) or faults_of_tree(file, raw, longest, values)
    except InputError as fault:
        return fault.faults


@contextmanager
def reading(path: Path, hdf5_path: str = "") -> Iterator[None]:
    """Turn what HDF5 says of damaged data into one line with file and place."""
    try:
        yield
    except DAMAGE as fault:
        where = f"{path}: {hdf5_path}" if hdf5_path else f"{path}"
        raise InputError(f"{where}: {damage_text(fault)}") from fault


def damage_text(fault: Exception) -> str:
    """What HDF5 says of data that it cannot read, in words a person can act on."""
    if isinstance(fault, MemoryError):
        return "holds more than fits into the memory of this computer"
    text = " ".join(str(fault).split())
    return TOO_NEW if "bad version number" in text else f"damaged: {text}"


def open_failure(fault: Exception) -> str:
    """HDF5's reason in words a person can act on."""
    text = str(fault)
    if "signature not found" in text:
        return "not an HDF5 file"
    if "truncated" in text:
        return "truncated: the file is shorter than it says; copy it again from where it was recorded"
    return f"HDF5 cannot open it: {' '.join(text.split())}"


def faults_of_root(file: Any, longest: int, root: dict[str, Any]) -> list[str]:
    """Whether the file is a run of a version that this program reads; adds its attributes to `root`."""
    try:
        if (names := int(h5py.h5a.get_num_attrs(file.id))) > MOST_NAMES:
            return [f"/: {names} attributes; at most {MOST_NAMES} were expected"]
        size = attribute_bytes(file.id)
        texts = [Node("/", h5py.h5o.open(file.id, b"/"))]
        if faults := (
            faults_of_attributes(size, "/") or faults_of_texts_in_attributes(texts, size, longest, MOST_ATTRIBUTES)
        ):
            return faults
        root |= layout.attributes(file)
    except DAMAGE as fault:
        return [f"its attributes cannot be read: {damage_text(fault)}"]
    if root.get("format") != layout.FORMAT:
        return [f"not a run file: attribute 'format' is {shown(root.get('format'))}, expected {layout.FORMAT!r}"]
    if root.get("format_version") != layout.VERSION:
        return [f"format_version is {shown(root.get('format_version'))}; this program reads {layout.VERSION}"]
    return []
