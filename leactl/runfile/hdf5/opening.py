"""Open run files and other HDF5 files safely; a file that cannot be read safely is refused with its faults.

A recording that is still being written, or whose writer was killed, can be opened too (see `swmr`).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import h5py

from leactl.errors import InputError
from leactl.regular_files import open_regular
from leactl.runfile import layout
from leactl.runfile.hdf5.swmr import FLAGS_AT, OPEN_FOR_WRITE, SIGNATURE, SWMR_WRITE, VERSION_AT, AsClosed
from leactl.runfile.hdf5.text_heaps import longest_text
from leactl.runfile.hdf5.tree import (
    MOST_ATTRIBUTE_BYTES,
    MOST_ATTRIBUTES,
    Node,
    attribute_bytes,
    faults_of_attributes,
    faults_of_foreign_tree,
    faults_of_texts_in_attributes,
    faults_of_tree,
    is_read_of_run,
)
from leactl.runfile.hdf5.value_types import faults_of_attribute_types
from leactl.yamlfile import shown

TOO_NEW = (
    f"written in a newer HDF5 format than h5py {h5py.__version__} with HDF5 {h5py.version.hdf5_version} reads; where it"
    " opens, `leactl runs convert` makes it old again"
)
# errors of h5py for a damaged file, such as TypeError for a type unknown to NumPy and ValueError for a wrong length
DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError)
MOST_REOPENINGS = 3  # of a live file, because it grew while it was checked
PAST_END_ERROR = "addr overflow"  # text of HDF5's error for an address beyond the file's size when it was opened
USUAL_SIZES = (8, 8)  # bytes of addresses and of lengths


def open_run_file(path: Path, root: dict[str, Any] | None = None, values: bool = True) -> tuple[Any, bool]:
    """Open a run file for reading, and return whether it is live: its writer still has it open, or was killed.

    Parameters
    ----------
    root : dictionary to which the attributes of the root group are added.
    values : whether more than the last value of each stream will be read, so that compressed chunks are checked too.

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
        first_bytes = raw.read(FLAGS_AT + 1)
        flags = (
            first_bytes[FLAGS_AT]
            if is_hdf5(first_bytes) and len(first_bytes) > FLAGS_AT and first_bytes[VERSION_AT] >= 3
            else 0
        )
        if flags & OPEN_FOR_WRITE and not flags & SWMR_WRITE:
            message = "the recording never started (its writer ended while preparing the file); delete it"
            raise InputError(f"{path}: {message}")
        live = bool(flags & SWMR_WRITE)
        for reopenings_left in range(MOST_REOPENINGS, -1, -1):
            try:
                file = h5py.File(AsClosed(raw) if live else path, "r")
            except DAMAGE as fault:
                raise InputError(f"{path}: {open_failure(fault)}") from fault
            try:
                faults = faults_of_form(file, first_bytes) or faults_of_file(
                    file, raw, {} if root is None else root, values
                )
            except DAMAGE as fault:
                faults = [damage_text(fault)]
            if faults:
                file.close()
            if not (reopenings_left and live and any(PAST_END_ERROR in fault for fault in faults)):
                break
        if faults:
            raise InputError([f"{path}: {fault}" for fault in faults])
    return file, live


def open_foreign(path: Path) -> Any:
    """Open an HDF5 file that is not a run file, such as a MAT file of version 7.3, for reading.

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


def is_hdf5(first_bytes: bytes) -> bool:
    """Return whether the first bytes of a file are the HDF5 signature."""
    return first_bytes.startswith(SIGNATURE)


def faults_of_form(file: Any, first_bytes: bytes) -> list[str]:
    """Return a line if the file does not begin with HDF5's signature, or its addresses or lengths have another size."""
    if not is_hdf5(first_bytes):
        return ["begins with bytes that are not HDF5's; none were expected before its part"]
    return faults_of_sizes(file)


def faults_of_sizes(file: Any) -> list[str]:
    """Return a line if addresses or lengths have an unusual size, for which the text heaps cannot be checked."""
    if (sizes := file.id.get_create_plist().get_sizes()) != USUAL_SIZES:
        return [f"its addresses and lengths have {sizes[0]} and {sizes[1]} bytes; 8 were expected"]
    return []


def faults_of_file(file: Any, raw: BinaryIO, root: dict[str, Any], values: bool) -> list[str]:
    """Return one line for each reason why the file is no readable run, and add its root attributes to `root`."""
    try:
        longest = longest_text(raw)
        return faults_of_root(file, longest, root) or faults_of_tree(file, raw, longest, values)
    except InputError as fault:
        return fault.faults


@contextmanager
def reading(path: Path, hdf5_path: str = "") -> Iterator[None]:
    """Convert HDF5's errors in the block to an InputError of one line with file and HDF5 path."""
    try:
        yield
    except DAMAGE as fault:
        location = f"{path}: {hdf5_path}" if hdf5_path else f"{path}"
        raise InputError(f"{location}: {damage_text(fault)}") from fault


def damage_text(fault: Exception) -> str:
    """Return one line that a person can act on, for an error while HDF5 reads data."""
    if isinstance(fault, MemoryError):
        return "holds more than fits into the memory of this computer"
    text = " ".join(str(fault).split())
    if "invalid identifier" in text or "invalid object ID" in text:
        return "the run is closed; read its channels inside the `with` block, or before close()"
    return TOO_NEW if "bad version number" in text else f"damaged: {text}"


def open_failure(fault: Exception) -> str:
    """Return one line that a person can act on, for an error while HDF5 opens a file."""
    text = str(fault)
    if "signature not found" in text:
        return "not an HDF5 file"
    if "truncated" in text:
        return "truncated: the file is shorter than it says; copy it again from where it was recorded"
    return f"HDF5 cannot open it: {' '.join(text.split())}"


def faults_of_root(file: Any, longest: int, root: dict[str, Any]) -> list[str]:
    """Return a line if the root attributes are not those of a run of a supported version; else add them to `root`.

    `longest` is the length of the longest text in the file's heaps [bytes].
    """
    try:
        if (names := int(h5py.h5a.get_num_attrs(file.id))) > MOST_ATTRIBUTES:
            return [f"/: {names} attributes; at most {MOST_ATTRIBUTES} were expected"]
        size = attribute_bytes(file.id)
        root_nodes = [Node("/", h5py.h5o.open(file.id, b"/"))]
        if faults := (
            faults_of_attributes(size, "/")
            or faults_of_attribute_types(file.id, "/", is_read_of_run)
            or faults_of_texts_in_attributes(root_nodes, size, longest, MOST_ATTRIBUTE_BYTES)
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
