"""What the tree of a run file may be, before anything of it is read: what it names, how large, how deep, of what kind.

A file of a few kB may announce a channel of 1e12 values that were never written, attributes that fill the memory, or
groups that hold themselves. Each is refused from what the object headers say, no value being read.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import h5py
import numpy as np

from leactl.errors import InputError
from leactl.runfile import layout

KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
DEEPEST: Final = 8  # groups in one another; the layout has 3
MOST_OBJECTS: Final = 10_000  # groups and datasets; a run of the largest bench has about 100
MOST_ATTRIBUTES: Final = 1 << 20  # bytes of one object; what is written here shares 64 KiB
MOST_ATTRIBUTES_OF_FILE: Final = 1 << 24  # bytes
MOST_UNWRITTEN: Final = 1 << 26  # bytes of values that were announced and not written, as a kill leaves them
ATTRIBUTE_HEADER: Final = 64  # bytes, about, of an attribute beside its value
DEFLATE_AT_MOST: Final = 1032  # values packed into one byte by deflate (zlib's technical details): more is no data
TEXT_IN_HEAP: Final = np.dtype([("length", "<u4"), ("heap", "<u8"), ("number", "<u4")])  # as a dataset holds a text
LARGEST_CHUNK: Final = 1 << 26  # bytes, which HDF5 takes at once to read a single value

GROUPS: Final = ("setup", "streams", "notes", *layout.SOURCES, *layout.TABLES)
TABLES: Final[dict[str, dict[str, int | None]]] = {**layout.TABLES, "notes": layout.NOTES}


class Node(NamedTuple):
    """An object of the tree and its path."""

    path: str
    item: Any


def faults_of_tree(file: Any) -> list[str]:
    """Everything that makes a file unfit to be read, one line each."""
    try:
        return faults_of_nodes(file) or faults_of_kinds(file)
    except InputError as fault:
        return fault.faults


def faults_of_nodes(file: Any) -> list[str]:
    """What no object of a run has, each with its path."""
    faults: list[str] = []
    attributes, unwritten, largest = 0, 0, ("", 0)
    for nodes, node in enumerate(walk(file, faults), start=1):
        attributes += attribute_bytes(node.item)
        faults += faults_of_node(node)
        if isinstance(node.item, h5py.Dataset):
            unwritten += (size := unwritten_bytes(node.item))
            largest = max(largest, (node.path, size), key=lambda one: one[1])
        if nodes > MOST_OBJECTS:
            raise InputError(f"more than {MOST_OBJECTS} groups and datasets; fewer were expected of a run")
    if attributes > MOST_ATTRIBUTES_OF_FILE and not faults:
        faults.append(f"{attributes} bytes of attributes; at most {MOST_ATTRIBUTES_OF_FILE} were expected")
    if unwritten > MOST_UNWRITTEN:
        faults.append(
            f"{largest[0]}: announces {largest[1]} bytes of values that were never written; at most {MOST_UNWRITTEN}"
            " were expected, as a recording that was cut off may leave them"
        )
    return faults


def walk(group: Any, faults: list[str], path: str = "", depth: int = 0) -> Iterator[Node]:
    """Every group and dataset below a group; links that lead elsewhere become faults and are not followed."""
    for name in group:
        place = f"{path}/{name}"
        if depth == DEEPEST:  # as where a group holds itself: what else is in it does not count
            raise InputError(f"{place}: lies in more than {DEEPEST} groups; fewer were expected of a run")
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            faults.append(f"{place}: a link instead of data; a run file holds everything itself")
            continue
        node = Node(place, group[name])
        yield node
        if isinstance(node.item, h5py.Group):
            yield from walk(node.item, faults, place, depth + 1)


def faults_of_node(node: Node) -> list[str]:
    """Attributes that are too many; of a dataset, values that lie elsewhere or cannot be had."""
    place, item = node
    faults = faults_of_attributes(item, place)
    if not isinstance(item, h5py.Dataset):
        return faults
    if item.is_virtual or item.external:
        faults.append(f"{place}: its values lie in another file; a run file holds everything itself")
    faults += [f"{place}: filter {code} is neither gzip nor shuffle" for code in filters(item) - KNOWN_FILTERS]
    if item.shape is None:
        faults.append(f"{place}: a dataset without values")
    elif item.chunks and (size := math.prod(item.chunks) * item.dtype.itemsize) > LARGEST_CHUNK:
        faults.append(f"{place}: chunks of {size} bytes; at most {LARGEST_CHUNK} were expected")
    elif item.dtype.kind == "O" and not layout.is_text(item):
        faults.append(f"{place}: values that are neither numbers nor text")
    elif (size := longest_text(item)) > (most := Path(item.file.filename).stat().st_size):
        faults.append(f"{place}: damaged: announces a text of {size} bytes in a file of {most}")
    return faults


def longest_text(dataset: Any) -> int:
    """Bytes of the longest text that a dataset announces, for which HDF5 takes memory before it looks for the text."""
    kind, offset = h5py.check_string_dtype(dataset.dtype), dataset.id.get_offset()
    if kind is None or kind.length is not None or offset is None:  # in chunks, which gzip checks
        return 0
    with Path(dataset.file.filename).open("rb") as raw:
        raw.seek(offset)
        texts = np.frombuffer(raw.read(dataset.size * TEXT_IN_HEAP.itemsize), TEXT_IN_HEAP)
    return int(texts["length"].max(initial=0))


def filters(dataset: Any) -> set[int]:
    """Codes of the filters that a dataset passes through."""
    plist = dataset.id.get_create_plist()
    return {plist.get_filter(index)[0] for index in range(plist.get_nfilters())}


def faults_of_attributes(item: Any, place: str) -> list[str]:
    """Whether the attributes of one object are more than anybody writes."""
    size = attribute_bytes(item)
    if size <= MOST_ATTRIBUTES:
        return []
    return [f"{place}: {size} bytes of attributes; at most {MOST_ATTRIBUTES} were expected"]


def attribute_bytes(item: Any) -> int:
    """What the attributes of an object take in the file, as their headers say."""
    count = int(h5py.h5a.get_num_attrs(item.id))
    least = count * ATTRIBUTE_HEADER
    if least > MOST_ATTRIBUTES:
        return least
    names: list[bytes] = []  # with which HDF5 goes straight to each; by numbers it begins anew every time
    h5py.h5a.iterate(item.id, names.append)
    return least + sum(stored_bytes(h5py.h5a.open(item.id, name)) for name in names)


def stored_bytes(attribute: Any) -> int:
    """What the value of an attribute takes in the file."""
    try:
        return int(attribute.get_storage_size())
    except RuntimeError:  # the 0 of an attribute without a value is a fault to h5py
        return 0


def unwritten_bytes(dataset: Any) -> int:
    """Bytes of values beyond what the dataset's space in the file can hold."""
    if dataset.shape is None:
        return 0
    size = int(math.prod(dataset.shape) * dataset.dtype.itemsize)
    if size <= MOST_UNWRITTEN // MOST_OBJECTS:  # the sum of so little stays below, and its space need not be asked for
        return 0
    packed = DEFLATE_AT_MOST if dataset.compression else 1
    return max(0, size - packed * int(dataset.id.get_storage_size()))


def faults_of_kinds(file: Any) -> list[str]:
    """Groups of the layout that are none, and columns of tables and texts that are of another kind."""
    faults = [
        f"/{name}: a dataset where a group was expected"
        for name in GROUPS
        if name in file and not isinstance(file[name], h5py.Group)
    ]
    if faults:
        return faults
    for name in layout.SOURCES:
        item = file.get(f"{name}/source")
        if item is not None and not (is_dataset_of(item, text=True) and item.size == 1):
            faults.append(f"/{name}/source: one text was expected")
    for table, columns in TABLES.items():
        for column, width in columns.items():
            item = file[table].get(column) if table in file else None
            text = width is not None
            if item is not None and not (is_dataset_of(item, text) and item.ndim == 1):
                faults.append(f"/{table}/{column}: one dimension of {'texts' if text else 'numbers'} was expected")
    return faults


def is_dataset_of(item: Any, text: bool) -> bool:
    """Whether an object is a dataset of texts, or else of numbers."""
    return isinstance(item, h5py.Dataset) and (layout.is_text(item) if text else item.dtype.kind in "fiu")
