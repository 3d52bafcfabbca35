"""What the tree of a run file may be, before anything of it is read: what it names, how large, how deep, of what kind.

A file of a few kB may announce a channel of 1e12 values that were never written, attributes that fill the memory, or
groups that hold themselves. Each is refused from what the object headers say, no value being read.
"""

import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple, Self

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
    item: Any  # its identifier of the low-level API, at a third of the cost of a `Group` or `Dataset`


class Storage(NamedTuple):
    """What the values of a dataset are and how they are stored, from its header."""

    dtype: "np.dtype[Any]"
    shape: tuple[int, ...] | None  # None where it has no values
    elsewhere: bool  # in another file
    filters: frozenset[int]
    chunk_values: int  # 0 where it is not chunked

    @classmethod
    def of(cls, dataset: Any) -> Self:
        """Ask once: every question to a dataset for its shape or its properties copies them all."""
        plist = dataset.get_create_plist()
        form = plist.get_layout()
        return cls(
            dtype=dataset.dtype,
            shape=dataset.shape,
            elsewhere=form == h5py.h5d.VIRTUAL or plist.get_external_count() > 0,
            filters=frozenset(plist.get_filter(index)[0] for index in range(plist.get_nfilters())),
            chunk_values=math.prod(plist.get_chunk()) if form == h5py.h5d.CHUNKED else 0,
        )

    @property
    def announced(self) -> int:
        """How many values it has, written or not."""
        return 0 if self.shape is None else math.prod(self.shape)

    @property
    def rank(self) -> int:
        """Its dimensions; 0 of a single value, or none."""
        return len(self.shape or ())

    def holds(self, text: bool) -> bool:
        """Whether its values are texts, or else numbers."""
        return h5py.check_string_dtype(self.dtype) is not None if text else self.dtype.kind in "fiu"


def faults_of_tree(file: Any) -> list[str]:
    """Everything that makes a file unfit to be read, one line each."""
    items: dict[str, Any] = {}
    try:
        with file_of(file.id).open("rb") as raw:
            return faults_of_nodes(file, raw, items) or faults_of_kinds(items)
    except InputError as fault:
        return fault.faults


def faults_of_nodes(file: Any, raw: BinaryIO, items: dict[str, Any]) -> list[str]:
    """What no object of a run has, each with its path; adds every object to `items`, of a dataset its storage."""
    faults: list[str] = []
    attributes, unwritten, largest = 0, 0, ("", 0)
    for path, item in walk(file.id, faults):
        items[path] = item
        size = attribute_bytes(item)
        attributes += size
        faults += faults_of_attributes(size, path)
        if isinstance(item, h5py.h5d.DatasetID):
            items[path] = storage = Storage.of(item)
            faults += faults_of_dataset(item, storage, path, raw)
            unwritten += (size := unwritten_bytes(item, storage))
            largest = max(largest, (path, size), key=lambda one: one[1])
        if len(items) > MOST_OBJECTS:
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
    for name, kind in links(group):
        place = f"{path}/{name.decode('utf-8', 'surrogateescape')}"
        if depth == DEEPEST:  # as where a group holds itself: what else is in it does not count
            raise InputError(f"{place}: lies in more than {DEEPEST} groups; fewer were expected of a run")
        if kind != h5py.h5l.TYPE_HARD:
            faults.append(f"{place}: a link instead of data; a run file holds everything itself")
            continue
        node = Node(place, h5py.h5o.open(group, name))
        yield node
        if isinstance(node.item, h5py.h5g.GroupID):
            yield from walk(node.item, faults, place, depth + 1)


def links(group: Any) -> list[tuple[bytes, int]]:
    """Name and type of each link of a group, up to one more than a whole file may have objects."""
    named: list[tuple[bytes, int]] = []

    def take(name: bytes, link: Any) -> bool | None:
        named.append((name, link.type))
        return len(named) > MOST_OBJECTS or None  # anything but None ends the iteration

    group.links.iterate(take, info=True)
    return named


def faults_of_dataset(dataset: Any, storage: Storage, place: str, raw: BinaryIO) -> list[str]:
    """Values that lie elsewhere or cannot be had."""
    faults = []
    if storage.elsewhere:
        faults.append(f"{place}: its values lie in another file; a run file holds everything itself")
    faults += [f"{place}: filter {code} is neither gzip nor shuffle" for code in storage.filters - KNOWN_FILTERS]
    if storage.shape is None:
        faults.append(f"{place}: a dataset without values")
    elif (size := storage.chunk_values * storage.dtype.itemsize) > LARGEST_CHUNK:
        faults.append(f"{place}: chunks of {size} bytes; at most {LARGEST_CHUNK} were expected")
    elif storage.dtype.kind == "O" and not storage.holds(text=True):
        faults.append(f"{place}: values that are neither numbers nor text")
    elif (size := longest_text(dataset, storage, raw)) and size > (most := os.fstat(raw.fileno()).st_size):
        faults.append(f"{place}: damaged: announces a text of {size} bytes in a file of {most}")
    return faults


def longest_text(dataset: Any, storage: Storage, raw: BinaryIO) -> int:
    """Bytes of the longest text that a dataset announces, for which HDF5 takes memory before it looks for the text."""
    kind = h5py.check_string_dtype(storage.dtype)
    if kind is None or kind.length is not None or (offset := dataset.get_offset()) is None:  # in chunks: gzip checks
        return 0
    raw.seek(offset)
    texts = np.frombuffer(raw.read(storage.announced * TEXT_IN_HEAP.itemsize), TEXT_IN_HEAP)
    return int(texts["length"].max(initial=0))


def file_of(item: Any) -> Path:
    """The file that an object is in."""
    return Path(os.fsdecode(h5py.h5f.get_name(item)))


def faults_of_attributes(size: int, place: str) -> list[str]:
    """Whether the attributes of one object are more than anybody writes."""
    if size <= MOST_ATTRIBUTES:
        return []
    return [f"{place}: {size} bytes of attributes; at most {MOST_ATTRIBUTES} were expected"]


def attribute_bytes(item: Any) -> int:
    """What the attributes of an object take in the file, as their headers say."""
    least = int(h5py.h5a.get_num_attrs(item)) * ATTRIBUTE_HEADER
    if not 0 < least <= MOST_ATTRIBUTES:
        return least
    sizes: list[int] = []
    # in one pass: to open each by its number, HDF5 begins anew every time
    h5py.h5a.iterate(item, lambda _name, attribute: sizes.append(attribute.data_size), info=True)
    return least + sum(sizes)


def unwritten_bytes(dataset: Any, storage: Storage) -> int:
    """Bytes of values beyond what the dataset's space in the file can hold."""
    size = storage.announced * storage.dtype.itemsize
    if size <= MOST_UNWRITTEN // MOST_OBJECTS:  # the sum of so little stays below, and its space need not be asked for
        return 0
    packed = DEFLATE_AT_MOST if h5py.h5z.FILTER_DEFLATE in storage.filters else 1
    return max(0, size - packed * int(dataset.get_storage_size()))


def faults_of_kinds(items: Mapping[str, Any]) -> list[str]:
    """Groups of the layout that are none, and columns of tables and texts that are of another kind."""
    faults = [
        f"/{name}: a dataset where a group was expected"
        for name in GROUPS
        if f"/{name}" in items and not isinstance(items[f"/{name}"], h5py.h5g.GroupID)
    ]
    if faults:
        return faults
    for name in layout.SOURCES:
        item = items.get(f"/{name}/source")
        if item is not None and not (isinstance(item, Storage) and item.holds(text=True) and item.announced == 1):
            faults.append(f"/{name}/source: one text was expected")
    for table, columns in TABLES.items():
        for column, width in columns.items():
            item = items.get(f"/{table}/{column}")
            text = width is not None
            if item is not None and not (isinstance(item, Storage) and item.holds(text) and item.rank == 1):
                faults.append(f"/{table}/{column}: one dimension of {'texts' if text else 'numbers'} was expected")
    return faults
