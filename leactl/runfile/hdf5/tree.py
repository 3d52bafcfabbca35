"""What the tree of a run file may be, before anything of it is read: what it names, how large, how deep, of what kind.

A file of a few kB may announce a channel of 1e12 values that were never written, attributes that fill the memory, a
text that is referred to a million times, chunks that unpack without end, or groups that hold themselves. Each is
refused from what the object headers, references and packed bytes say, no value being read by HDF5.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, BinaryIO, Final, NamedTuple, Self

import h5py
import numpy as np

from leactl.errors import InputError
from leactl.runfile import layout
from leactl.runfile.hdf5.chunks import DEFLATE_AT_MOST, chunks, exceeds_announced, filters, unpacked

KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
DEEPEST: Final = 8  # groups in one another; the layout has 3
DEEPEST_FOREIGN: Final = 32  # structs and cells of other programs in one another
MOST_OBJECTS: Final = 10_000  # groups and datasets; a run of the largest bench has about 100
MOST_ROWS_OF_TABLE: Final = 1 << 17  # of steps, events and notes
MOST_TEXTS: Final = 1 << 19  # in all datasets
MOST_TEXT: Final = 1 << 26  # bytes of them
MOST_NAMES: Final = 1 << 13  # of attributes; to read one by its name, HDF5 looks at all others of its object
MOST_ATTRIBUTES: Final = 1 << 20  # bytes of one object; what is written here shares 64 KiB
MOST_ATTRIBUTES_OF_FILE: Final = 1 << 24  # bytes
MOST_UNWRITTEN: Final = 1 << 26  # bytes of values that were announced and not written, as a kill leaves them
ATTRIBUTE_HEADER: Final = 64  # bytes, about, of an attribute beside its value
MOST_UNPACKED: Final = 32, 1 << 28  # bytes of all values: times those of the file, and as many beside
TEXT_IN_HEAP: Final = np.dtype([("length", "<u4"), ("heap", "<u8"), ("number", "<u4")])  # as a dataset holds a text
MOST_UNSEEN: Final = 1 << 26  # bytes that the chunks of a file may give without being looked at
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
    in_header: bool  # in the object's header instead of a block of their own
    filters: tuple[int, ...]
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
            in_header=form == h5py.h5d.COMPACT,
            filters=filters(plist),
            chunk_values=math.prod(plist.get_chunk()) if form == h5py.h5d.CHUNKED else 0,
        )

    @property
    def announced(self) -> int:
        """How many values it has, written or not."""
        return 0 if self.shape is None else math.prod(self.shape)

    @property
    def size(self) -> int:
        """Bytes of its values, a text of any length as a reference."""
        return self.announced * self.dtype.itemsize

    @property
    def chunk_size(self) -> int:
        """Bytes of one chunk, unpacked; 0 where it is not chunked."""
        value = TEXT_IN_HEAP if self.is_text_of_any_length else self.dtype
        return self.chunk_values * int(value.itemsize)

    @property
    def is_packed(self) -> bool:
        """Whether its chunks are packed."""
        return h5py.h5z.FILTER_DEFLATE in self.filters

    @property
    def is_text(self) -> bool:
        """Whether its values are texts."""
        return h5py.check_string_dtype(self.dtype) is not None

    @property
    def is_text_of_any_length(self) -> bool:
        """Whether its values are references to texts in the file's heaps."""
        kind = h5py.check_string_dtype(self.dtype)
        return kind is not None and kind.length is None

    @property
    def rank(self) -> int:
        """Its dimensions; 0 of a single value, or none."""
        return len(self.shape or ())

    def holds(self, text: bool) -> bool:
        """Whether its values are texts, or else numbers."""
        return self.is_text if text else self.dtype.kind in "fiu"


def faults_of_tree(file: Any, raw: BinaryIO, longest: int, values: bool = True) -> list[str]:
    """Everything that makes a file unfit to be read, one line each.

    Parameters
    ----------
    raw : the bytes of the file.
    longest : bytes of the longest text in its heaps.
    values : whether more of the packed values will be read than `packing.last_value` looks at itself.
    """
    tree = Tree(raw, longest)
    try:
        faults = tree.faults_of_nodes(file) or faults_of_kinds(tree.items)
        return faults or (tree.faults_of_packing() if values else [])
    except InputError as fault:
        return fault.faults


def faults_of_foreign_tree(file: Any, raw: BinaryIO, longest: int) -> list[str]:
    """The like of a file that is no run, as a MAT file of version 7.3 is none."""
    tree = Tree(raw, longest, foreign=True)
    try:
        return tree.faults_of_nodes(file) or tree.faults_of_packing()
    except InputError as fault:
        return fault.faults


class Tree:
    """The objects of a file with what they take, added up while it is walked through."""

    def __init__(self, raw: BinaryIO, longest: int, foreign: bool = False) -> None:
        self.items: dict[str, Any] = {}  # by path: of a dataset its storage
        self._foreign = foreign  # not a run: deeper, with references, and no text but in arrays of numbers
        self._raw, self._longest, self._file_size = raw, longest, os.fstat(raw.fileno()).st_size
        self._datasets: list[tuple[str, Any, Storage]] = []

    def faults_of_nodes(self, file: Any) -> list[str]:
        """What no object of a run has, and what all of them are not to have together, each with its path."""
        faults: list[str] = []
        nodes: list[Node] = []
        attributes = names = 0
        for path, item in walk(file.id, faults, DEEPEST_FOREIGN if self._foreign else DEEPEST):
            self.items[path] = item
            nodes.append(Node(path, item))
            names += int(h5py.h5a.get_num_attrs(item))
            if names > MOST_NAMES:
                raise InputError(f"{path}: more than {MOST_NAMES} attributes in this file; fewer were expected")
            size = attribute_bytes(item)
            attributes += size
            faults += faults_of_attributes(size, path)
            if isinstance(item, h5py.h5d.DatasetID):
                self.items[path] = storage = Storage.of(item)
                self._datasets.append((path, item, storage))
                faults += faults_of_dataset(storage, path, self._foreign)
            if len(self.items) > MOST_OBJECTS:
                raise InputError(f"more than {MOST_OBJECTS} groups and datasets; fewer were expected of a run")
        if attributes > MOST_ATTRIBUTES_OF_FILE and not faults:
            faults.append(f"{attributes} bytes of attributes; at most {MOST_ATTRIBUTES_OF_FILE} were expected")
        return (
            faults
            or faults_of_texts_in_attributes(nodes, attributes, self._longest, MOST_ATTRIBUTES_OF_FILE)
            or self._faults_of_sizes()
            or self._faults_of_texts()
        )

    def _faults_of_sizes(self) -> list[str]:
        """Values that are not there, that lie over one another, or that are more than can be looked at."""
        unwritten, largest = 0, ("", 0)
        stored: dict[int, int] = {}  # by address: an object may have two names
        for path, item, storage in self._datasets:
            if storage.size <= MOST_UNWRITTEN // MOST_OBJECTS:  # the sum of so little stays below
                continue
            taken = int(item.get_storage_size())
            stored[h5py.h5o.get_info(item).addr] = taken
            size = max(0, storage.size - (DEFLATE_AT_MOST if storage.is_packed else 1) * taken)
            unwritten += size
            largest = max(largest, (path, size), key=lambda candidate: candidate[1])
        if unwritten > MOST_UNWRITTEN:
            return [
                f"{largest[0]}: announces {largest[1]} bytes of values that were never written; at most"
                f" {MOST_UNWRITTEN} were expected, as a recording that was cut off may leave them"
            ]
        if (size := sum(stored.values())) > self._file_size:
            return [f"damaged: its values take {size} bytes in a file of {self._file_size}"]
        most = MOST_UNPACKED[0] * self._file_size + MOST_UNPACKED[1]
        if (size := sum(storage.size for _, _, storage in self._datasets)) > most:
            return [f"{size} bytes of values in a file of {self._file_size}; at most {most} were expected"]
        return []

    def _faults_of_texts(self) -> list[str]:
        """Texts that are many, or long, or one text that is referred to again and again."""
        count = size = 0
        for path, item, storage in self._datasets:
            if not storage.is_text:
                continue
            count += storage.announced
            if count > MOST_TEXTS:
                return [f"{path}: more than {MOST_TEXTS} texts in this file; fewer were expected"]
            if not storage.is_text_of_any_length:
                size += storage.size
                continue
            if storage.in_header and storage.announced * self._longest > MOST_TEXT:
                return [f"{path}: {storage.announced} texts in its header; one of the file has {self._longest} bytes"]
            lengths = self._lengths(item, storage)
            if lengths is None:
                return [f"{path}: damaged: a chunk of texts cannot be unpacked to what it announces"]
            if (longest := int(lengths.max(initial=0))) > self._file_size:
                return [f"{path}: damaged: announces a text of {longest} bytes in a file of {self._file_size}"]
            size += int(lengths.sum())
        return [] if size <= MOST_TEXT else [f"{size} bytes of text; at most {MOST_TEXT} were expected"]

    def _lengths(self, item: Any, storage: Storage) -> "np.ndarray[Any, Any] | None":
        """How long the texts of a dataset are, from its references; none where these are in its header.

        None stands for references that cannot be had.
        """
        size = TEXT_IN_HEAP.itemsize
        if storage.is_packed:
            chunks_unpacked = [unpacked(item, chunk, storage.chunk_size, size) for chunk in chunks(item)]
            if any(chunk_bytes is None for chunk_bytes in chunks_unpacked):
                return None
            references = b"".join(chunk_bytes for chunk_bytes in chunks_unpacked if chunk_bytes is not None)
            return np.frombuffer(references, TEXT_IN_HEAP, len(references) // size)["length"].astype(np.int64)
        if storage.chunk_values:
            parts = [(chunk.byte_offset, chunk.size) for chunk in chunks(item)]
        else:
            parts = [(item.get_offset(), storage.announced * TEXT_IN_HEAP.itemsize)]
        references = b""
        for at, size in parts:
            if at is not None:  # None: not written, or in the header
                self._raw.seek(at)
                references += self._raw.read(min(size, self._file_size))
        return np.frombuffer(references, TEXT_IN_HEAP, len(references) // TEXT_IN_HEAP.itemsize)["length"].astype(
            np.int64
        )

    def faults_of_packing(self) -> list[str]:
        """Chunks that unpack to more than they announce; where all of them together give little, none is looked at."""
        packed = [(path, item, storage) for path, item, storage in self._datasets if storage.is_packed]
        if DEFLATE_AT_MOST * sum(int(item.get_storage_size()) for _, item, _ in packed) <= MOST_UNSEEN:
            return []
        return [
            f"{path}: damaged: a chunk unpacks to more than the {storage.chunk_size} bytes that it announces"
            for path, item, storage in packed
            if any(exceeds_announced(item, chunk, storage.chunk_size) for chunk in chunks(item))
        ]


def walk(group: Any, faults: list[str], deepest: int, path: str = "", depth: int = 0) -> Iterator[Node]:
    """Every group and dataset below a group; links that lead elsewhere become faults and are not followed."""
    for name, kind in links(group):
        node_path = f"{path}/{name.decode('utf-8', 'surrogateescape')}"
        if depth == deepest:  # as where a group holds itself: what else is in it does not count
            raise InputError(f"{node_path}: lies in more than {deepest} groups; fewer were expected")
        if kind != h5py.h5l.TYPE_HARD:
            faults.append(f"{node_path}: a link instead of data; no link is followed")
            continue
        node = Node(node_path, h5py.h5o.open(group, name))
        yield node
        if isinstance(node.item, h5py.h5g.GroupID):
            yield from walk(node.item, faults, deepest, node_path, depth + 1)


def links(group: Any) -> list[tuple[bytes, int]]:
    """Name and type of each link of a group, up to one more than a whole file may have objects."""
    named: list[tuple[bytes, int]] = []

    def take(name: bytes, link: Any) -> bool | None:
        named.append((name, link.type))
        return len(named) > MOST_OBJECTS or None  # anything but None ends the iteration

    group.links.iterate(take, info=True)
    return named


def faults_of_dataset(storage: Storage, hdf5_path: str, foreign: bool = False) -> list[str]:
    """Values that lie elsewhere or cannot be had; a run has texts, a foreign file references to its own objects."""
    faults = []
    if storage.elsewhere:
        faults.append(f"{hdf5_path}: its values lie in another file; no other is opened")
    faults += [f"{hdf5_path}: filter {code} is neither gzip nor shuffle" for code in {*storage.filters} - KNOWN_FILTERS]
    if len({*storage.filters}) < len(storage.filters):
        faults.append(f"{hdf5_path}: packed more than once")
    if storage.shape is None:
        faults.append(f"{hdf5_path}: a dataset without values")
    elif storage.chunk_size > LARGEST_CHUNK:
        faults.append(f"{hdf5_path}: chunks of {storage.chunk_size} bytes; at most {LARGEST_CHUNK} were expected")
    elif storage.dtype.hasobject and not (is_reference(storage) if foreign else storage.is_text):
        faults.append(f"{hdf5_path}: values that are neither numbers nor {'references' if foreign else 'text'}")
    elif storage.dtype.hasobject and foreign and storage.announced > MOST_OBJECTS:
        faults.append(f"{hdf5_path}: {storage.announced} references; at most {MOST_OBJECTS} were expected")
    return faults


def is_reference(storage: Storage) -> bool:
    """Whether its values refer to whole objects of the file."""
    return h5py.check_ref_dtype(storage.dtype) is h5py.Reference


def faults_of_attributes(size: int, hdf5_path: str) -> list[str]:
    """Whether the attributes of one object are more than anybody writes."""
    if size <= MOST_ATTRIBUTES:
        return []
    return [f"{hdf5_path}: {size} bytes of attributes; at most {MOST_ATTRIBUTES} were expected"]


def attribute_bytes(item: Any) -> int:
    """What the attributes of an object take in the file, as their headers say."""
    least = int(h5py.h5a.get_num_attrs(item)) * ATTRIBUTE_HEADER
    if not 0 < least <= MOST_ATTRIBUTES:
        return least
    sizes: list[int] = []
    # in one pass: to open each by its number, HDF5 begins anew every time
    h5py.h5a.iterate(item, lambda _name, attribute: sizes.append(attribute.data_size), info=True)
    return least + sum(sizes)


def faults_of_texts_in_attributes(nodes: Iterable[Node], size: int, longest: int, most: int) -> list[str]:
    """Attributes whose texts are longer than all others may be.

    Parameters
    ----------
    nodes : objects that have attributes.
    size : bytes of these, a text as its reference.
    longest : bytes of the longest text in the file's heaps; as long as none is too long at this, none is read.
    most : bytes of all texts.
    """
    if size // TEXT_IN_HEAP.itemsize * longest <= most:
        return []
    total = 0
    for path, item in nodes:
        of_item = 0
        for name in attribute_names(item):
            attribute = h5py.h5a.open(item, name)
            kind = h5py.check_string_dtype(attribute.dtype)
            if kind is None or kind.length is not None:
                continue
            count = math.prod(attribute.shape)
            if count > 1 and count * longest > MOST_TEXT:
                return [f"{path}: an attribute of {count} texts in a file that has one of {longest} bytes"]
            texts = np.empty(attribute.shape, attribute.dtype)
            attribute.read(texts)
            of_item += sum(len(text) for text in texts.flat)
            if (more := faults_of_attributes(of_item, path)) or total + of_item > most:
                return more or [f"more than {most} bytes of texts in attributes; fewer were expected"]
        total += of_item
    return []


def attribute_names(item: Any) -> list[bytes]:
    """Names of an object's attributes."""
    names: list[bytes] = []
    h5py.h5a.iterate(item, names.append)
    return names


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
            elif item is not None and item.announced > MOST_ROWS_OF_TABLE:
                faults.append(f"/{table}/{column}: {item.announced} rows; at most {MOST_ROWS_OF_TABLE} were expected")
    return faults
