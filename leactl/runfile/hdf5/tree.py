"""Check the object tree of an HDF5 file before its values are read: names, sizes, depth and kinds of its objects.

A file of a few kB may announce a channel of 1e12 values that were never written, attributes that fill the memory, a
text with a million references to it, chunks that decompress to any size, or groups that contain themselves. The checks
need object headers, references and compressed bytes only; HDF5 reads no value.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, BinaryIO, Final, NamedTuple, Self

import h5py
import numpy as np

from leactl.errors import InputError
from leactl.runfile import layout
from leactl.runfile.hdf5.btrees import BTrees
from leactl.runfile.hdf5.chunks import MOST_DEFLATE_RATIO, chunks, exceeds_announced, filters, unpacked
from leactl.runfile.hdf5.value_types import (
    attribute_names,
    description_of_type,
    faults_of_attribute_types,
    is_shallow,
    is_text_of_any_length,
)
from leactl.yamlfile import shown

KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
MOST_LEVELS: Final = 8  # nested groups; the layout has 3
MOST_FOREIGN_LEVELS: Final = 32  # nested structs and cells in files of other programs
MOST_OBJECTS: Final = 10_000  # groups and datasets; a run of the largest bench has about 100
LONGEST_NAME: Final = 1 << 10  # bytes, of one object or link; MATLAB's names have at most 63
MOST_PATH_BYTES: Final = 1 << 22  # bytes of the paths of all objects: 400 for each of 10,000
MOST_ROWS_OF_TABLE: Final = 1 << 17  # of steps, events and notes
MOST_TEXTS: Final = 1 << 19  # number of texts in all datasets
MOST_TEXT_BYTES: Final = 1 << 26  # of all texts together
MOST_ATTRIBUTES: Final = 1 << 13  # attributes; to read one by its name, HDF5 searches all attributes of its object
MOST_ATTRIBUTE_BYTES: Final = 1 << 20  # bytes of the attributes of one object; in a run file they share 64 KiB
MOST_ATTRIBUTE_BYTES_OF_FILE: Final = 1 << 24  # bytes of the attributes of all objects
MOST_UNWRITTEN_BYTES: Final = 1 << 26  # bytes of values that were announced and not written, as after a kill
ATTRIBUTE_HEADER: Final = 64  # approximate bytes of an attribute without its value
MOST_UNPACKED: Final = 32, 1 << 28  # the values of a file may have 32 times the file's size plus 256 MiB
TEXT_IN_HEAP: Final = np.dtype([("length", "<u4"), ("heap", "<u8"), ("number", "<u4")])  # reference to a text in a heap
MOST_UNCHECKED_BYTES: Final = 1 << 26  # bytes that the chunks of a file may decompress to without being checked
LARGEST_CHUNK: Final = 1 << 26  # bytes; HDF5 reads a whole chunk for a single value

WRONG_VALUES: Final = ("values that are neither numbers nor text", "values that are neither numbers nor references")
READ_OF_MAT: Final = (b"MATLAB_class", b"MATLAB_empty")  # attributes of MAT files whose values are read

GROUPS: Final = ("setup", "streams", "notes", *layout.SOURCES, *layout.TABLES)
TABLES: Final[dict[str, dict[str, int | None]]] = {**layout.TABLES, "notes": layout.NOTES}


class Node(NamedTuple):
    """A group, dataset or link with its path in the file."""

    path: str
    item: Any  # identifier of h5py's low-level API, three times as fast as a `Group` or `Dataset`; None for a link


class Storage(NamedTuple):
    """Type, shape and storage of a dataset's values, from its object header."""

    dtype: "np.dtype[Any]"
    shape: tuple[int, ...] | None  # None for a dataset without values
    elsewhere: bool  # whether the values are in another file
    in_header: bool  # whether the values are in the object's header instead of a separate block
    filters: tuple[int, ...]  # HDF5 filter codes, in the order of application
    chunk_values: int  # values in a chunk; 0 if the dataset is not chunked

    @classmethod
    def of(cls, dataset: Any) -> Self:
        """Read a dataset's header once, because each access to its shape or properties copies all of them."""
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
        """Number of announced values, whether written or not."""
        return 0 if self.shape is None else math.prod(self.shape)

    @property
    def size(self) -> int:
        """Size of the values [bytes]; a text of variable length counts as its reference."""
        return self.announced * self.dtype.itemsize

    @property
    def chunk_size(self) -> int:
        """Size of one decompressed chunk [bytes]; 0 if the dataset is not chunked."""
        value = TEXT_IN_HEAP if self.is_text_of_any_length else self.dtype
        return self.chunk_values * int(value.itemsize)

    @property
    def is_packed(self) -> bool:
        """Whether the chunks are compressed."""
        return h5py.h5z.FILTER_DEFLATE in self.filters

    @property
    def is_text(self) -> bool:
        """Whether the values are texts."""
        return h5py.check_string_dtype(self.dtype) is not None

    @property
    def is_text_of_any_length(self) -> bool:
        """Whether the values are references to texts in the file's heaps."""
        kind = h5py.check_string_dtype(self.dtype)
        return kind is not None and kind.length is None

    @property
    def rank(self) -> int:
        """Number of dimensions; 0 for a scalar or a dataset without values."""
        return len(self.shape or ())

    def holds(self, text: bool) -> bool:
        """Return whether the values are texts (`text` True) or numbers (`text` False)."""
        return self.is_text if text else self.dtype.kind in "fiu"


def faults_of_tree(file: Any, raw: BinaryIO, longest: int, values: bool = True) -> list[str]:
    """Return one line for each reason why a run file cannot be read safely.

    Parameters
    ----------
    raw : the file, opened for reading bytes.
    longest : length of the longest text in its heaps [bytes].
    values : whether more than the last value of each stream will be read, so that compressed chunks are checked too.
    """
    tree = Tree(raw, longest)
    try:
        faults = tree.faults_of_nodes(file) or faults_of_kinds(tree.items)
        return faults or (tree.faults_of_packing() if values else [])
    except InputError as fault:
        return fault.faults


def faults_of_foreign_tree(file: Any, raw: BinaryIO, longest: int) -> list[str]:
    """Return one line for each reason why an HDF5 file of another program, such as MATLAB, cannot be read safely."""
    tree = Tree(raw, longest, foreign=True)
    try:
        return tree.faults_of_nodes(file) or tree.faults_of_packing()
    except InputError as fault:
        return fault.faults


class Tree:
    """Checker of the objects of a file, one by one and by the sums of their sizes."""

    def __init__(self, raw: BinaryIO, longest: int, foreign: bool = False) -> None:
        self.items: dict[str, Any] = {}  # by path: the storage of a dataset, or the identifier of another object
        self._foreign = foreign  # a file of another program: deeper, with references, and text as arrays of numbers
        self._raw, self._longest, self._file_size = raw, longest, os.fstat(raw.fileno()).st_size
        self._datasets: list[tuple[str, Any, Storage]] = []

    def faults_of_nodes(self, file: Any) -> list[str]:
        """Return the faults of single objects and of their sums, one line each, with the object's path."""
        faults: list[str] = []
        nodes: list[Node] = []
        attribute_bytes_of_file = attribute_count = path_bytes = 0
        btrees = BTrees(self._raw, file.id.get_create_plist().get_userblock())
        btrees.check(h5py.h5g.get_objinfo(file.id, b"/").objno[0], "/")  # `h5o.get_info` would walk the tree
        most_levels = MOST_FOREIGN_LEVELS if self._foreign else MOST_LEVELS
        for count, (path, item) in enumerate(walk(file.id, btrees, most_levels), 1):
            path_bytes += len(path)
            if count > MOST_OBJECTS:
                raise InputError(f"more than {MOST_OBJECTS} groups and datasets; fewer were expected of a run")
            if path_bytes > MOST_PATH_BYTES:
                raise InputError(f"more than {MOST_PATH_BYTES} bytes of names; fewer were expected")
            if item is None:
                faults.append(f"{path}: a link instead of data; no link is followed")
                continue
            self.items[path] = item
            nodes.append(Node(path, item))
            attribute_count += int(h5py.h5a.get_num_attrs(item))
            if attribute_count > MOST_ATTRIBUTES:
                raise InputError(f"{path}: more than {MOST_ATTRIBUTES} attributes in this file; fewer were expected")
            size = attribute_bytes(item)
            attribute_bytes_of_file += size
            is_read = is_read_of_mat if self._foreign else is_read_of_run
            faults += faults_of_attributes(size, path) or faults_of_attribute_types(item, path, is_read)
            if isinstance(item, h5py.h5d.DatasetID) and not is_shallow(item.get_type()):
                expected = "references" if self._foreign else "text"
                faults.append(f"{path}: values that are {description_of_type(item.get_type(), expected)}")
            elif isinstance(item, h5py.h5d.DatasetID):
                self.items[path] = storage = Storage.of(item)
                self._datasets.append((path, item, storage))
                faults += faults_of_dataset(storage, path, self._foreign)
        if attribute_bytes_of_file > MOST_ATTRIBUTE_BYTES_OF_FILE and not faults:
            faults.append(
                f"{attribute_bytes_of_file} bytes of attributes; at most {MOST_ATTRIBUTE_BYTES_OF_FILE} were expected"
            )
        return (
            faults
            or faults_of_texts_in_attributes(
                nodes, attribute_bytes_of_file, self._longest, MOST_ATTRIBUTE_BYTES_OF_FILE
            )
            or self._faults_of_sizes()
            or self._faults_of_texts()
        )

    def _faults_of_sizes(self) -> list[str]:
        """Return a line if too many values were never written, overlap one another, or exceed `MOST_UNPACKED`."""
        unwritten_bytes, largest_gap = 0, ("", 0)
        stored_by_address: dict[int, int] = {}  # bytes by address, since an object may have two names
        for path, item, storage in self._datasets:
            # even `MOST_OBJECTS` datasets of this size together stay below the limit
            if storage.size <= MOST_UNWRITTEN_BYTES // MOST_OBJECTS:
                continue
            stored_bytes = int(item.get_storage_size())
            stored_by_address[h5py.h5o.get_info(item).addr] = stored_bytes
            size = max(0, storage.size - (MOST_DEFLATE_RATIO if storage.is_packed else 1) * stored_bytes)
            unwritten_bytes += size
            largest_gap = max(largest_gap, (path, size), key=lambda candidate: candidate[1])
        if unwritten_bytes > MOST_UNWRITTEN_BYTES:
            return [
                f"{largest_gap[0]}: announces {largest_gap[1]} bytes of values that were never written; at most"
                f" {MOST_UNWRITTEN_BYTES} were expected, as a recording that was cut off may leave them"
            ]
        if (size := sum(stored_by_address.values())) > self._file_size:
            return [f"damaged: its values take {size} bytes in a file of {self._file_size}"]
        most_bytes = MOST_UNPACKED[0] * self._file_size + MOST_UNPACKED[1]
        if (size := sum(storage.size for _, _, storage in self._datasets)) > most_bytes:
            return [f"{size} bytes of values in a file of {self._file_size}; at most {most_bytes} were expected"]
        return []

    def _faults_of_texts(self) -> list[str]:
        """Return a line if the texts are too many or too long; a text counts once for each reference to it."""
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
            if storage.in_header and storage.announced * self._longest > MOST_TEXT_BYTES:
                return [f"{path}: {storage.announced} texts in its header; one of the file has {self._longest} bytes"]
            lengths = self._lengths(item, storage)
            if lengths is None:
                return [f"{path}: damaged: a chunk of texts cannot be unpacked to what it announces"]
            if (longest := int(lengths.max(initial=0))) > self._file_size:
                return [f"{path}: damaged: announces a text of {longest} bytes in a file of {self._file_size}"]
            size += int(lengths.sum())
        return [] if size <= MOST_TEXT_BYTES else [f"{size} bytes of text; at most {MOST_TEXT_BYTES} were expected"]

    def _lengths(self, item: Any, storage: Storage) -> "np.ndarray[Any, Any] | None":
        """Return the lengths of a dataset's texts [bytes], from its references.

        Empty if the references are in the object header, None if they cannot be read.
        """
        size = TEXT_IN_HEAP.itemsize
        if storage.is_packed:
            chunks_unpacked = [unpacked(item, chunk, storage.chunk_size, size) for chunk in chunks(item)]
            if any(chunk_bytes is None for chunk_bytes in chunks_unpacked):
                return None
            references = b"".join(chunk_bytes for chunk_bytes in chunks_unpacked if chunk_bytes is not None)
            return np.frombuffer(references, TEXT_IN_HEAP, len(references) // size)["length"].astype(np.int64)
        if storage.chunk_values:
            stored_ranges = [(chunk.byte_offset, chunk.size) for chunk in chunks(item)]
        else:
            stored_ranges = [(item.get_offset(), storage.announced * TEXT_IN_HEAP.itemsize)]
        references = b""
        for offset, size in stored_ranges:
            if offset is not None:  # None: not written, or in the header
                self._raw.seek(offset)
                references += self._raw.read(min(size, self._file_size))
        return np.frombuffer(references, TEXT_IN_HEAP, len(references) // TEXT_IN_HEAP.itemsize)["length"].astype(
            np.int64
        )

    def faults_of_packing(self) -> list[str]:
        """Return a line for each dataset with a chunk that decompresses to more bytes than announced.

        No chunk is decompressed if all of them together cannot exceed `MOST_UNCHECKED_BYTES`.
        """
        packed = [(path, item, storage) for path, item, storage in self._datasets if storage.is_packed]
        if MOST_DEFLATE_RATIO * sum(int(item.get_storage_size()) for _, item, _ in packed) <= MOST_UNCHECKED_BYTES:
            return []
        return [
            f"{path}: damaged: a chunk unpacks to more than the {storage.chunk_size} bytes that it announces"
            for path, item, storage in packed
            if any(exceeds_announced(item, chunk, storage.chunk_size) for chunk in chunks(item))
        ]


def walk(group: Any, btrees: BTrees, most_levels: int, path: str = "", depth: int = 0) -> Iterator[Node]:
    """Yield every group and dataset below a group, and every soft and external link, which is not followed."""
    for name, kind, header in links(group):
        name_text = name.decode("utf-8", "surrogateescape")
        if len(name) > LONGEST_NAME:
            raise InputError(
                f"{path}/{shown(name_text)}: a name of {len(name)} bytes; at most {LONGEST_NAME} were expected"
            )
        node_path = f"{path}/{name_text}"
        if depth == most_levels:  # for example if a group contains itself
            raise InputError(f"{node_path}: lies in more than {most_levels} groups; fewer were expected")
        if kind != h5py.h5l.TYPE_HARD:
            yield Node(node_path, None)
            continue
        btrees.check(header, node_path)
        node = Node(node_path, h5py.h5o.open(group, name))
        yield node
        if isinstance(node.item, h5py.h5g.GroupID):
            yield from walk(node.item, btrees, most_levels, node_path, depth + 1)


def links(group: Any) -> list[tuple[bytes, int, int]]:
    """Return name and type of each link of a group, and the object's address for a hard link, sorted by name.

    The list ends after `MOST_OBJECTS` + 1 links, or after a name that is too long.
    """
    entries: list[tuple[bytes, int, int]] = []

    def add(name: bytes, link: Any) -> bool | None:
        entries.append((name, link.type, link.u))
        # any value but None ends the iteration; a few bytes in the file may give every link the same long name
        return len(entries) > MOST_OBJECTS or len(name) > LONGEST_NAME or None

    group.links.iterate(add, info=True, order=h5py.h5.ITER_NATIVE)  # in another order HDF5 first copies all names
    return sorted(entries)


def faults_of_dataset(storage: Storage, hdf5_path: str, foreign: bool = False) -> list[str]:
    """Return one line for each reason why a dataset's values cannot be read.

    Besides numbers, a run may have texts; a foreign file may have references to objects of the same file.
    """
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
        faults.append(f"{hdf5_path}: {WRONG_VALUES[foreign]}")
    elif storage.dtype.hasobject and foreign and storage.announced > MOST_OBJECTS:
        faults.append(f"{hdf5_path}: {storage.announced} references; at most {MOST_OBJECTS} were expected")
    return faults


def is_reference(storage: Storage) -> bool:
    """Return whether the values are references to objects of the file."""
    return h5py.check_ref_dtype(storage.dtype) is h5py.Reference


def is_read_of_run(name: bytes) -> bool:
    """Return whether the value of an attribute of a run file is read: all but those of HDF5's dimension scales."""
    return name.decode("utf-8", "surrogateescape") not in layout.OF_SCALES


def is_read_of_mat(name: bytes) -> bool:
    """Return whether the value of an attribute of a MAT file is read."""
    return name in READ_OF_MAT


def faults_of_attributes(size: int, hdf5_path: str) -> list[str]:
    """Return a line if the attributes of one object exceed `MOST_ATTRIBUTE_BYTES` bytes."""
    if size <= MOST_ATTRIBUTE_BYTES:
        return []
    return [f"{hdf5_path}: {size} bytes of attributes; at most {MOST_ATTRIBUTE_BYTES} were expected"]


def attribute_bytes(item: Any) -> int:
    """Return the size of an object's attributes [bytes], by their headers."""
    header_bytes = int(h5py.h5a.get_num_attrs(item)) * ATTRIBUTE_HEADER
    if not 0 < header_bytes <= MOST_ATTRIBUTE_BYTES:
        return header_bytes
    sizes: list[int] = []
    # in one pass, since HDF5 searches from the beginning for each attribute that is opened by its number
    h5py.h5a.iterate(item, lambda _name, attribute: sizes.append(attribute.data_size), info=True)
    return header_bytes + sum(sizes)


def faults_of_texts_in_attributes(nodes: Iterable[Node], size: int, longest: int, most_bytes: int) -> list[str]:
    """Return a line if texts in attributes exceed the limits.

    Parameters
    ----------
    nodes : the objects whose attributes are checked.
    size : size of all their attributes [bytes]; a text counts as its reference.
    longest : length of the longest text in the file's heaps [bytes]; if it rules out an excess, no text is read.
    most_bytes : limit of the size of all texts [bytes].
    """
    if size // TEXT_IN_HEAP.itemsize * longest <= most_bytes:
        return []
    total_bytes = 0
    for path, item in nodes:
        item_bytes = 0
        for name in attribute_names(item):
            attribute = h5py.h5a.open(item, name)
            if not is_text_of_any_length(attribute.get_type()):
                continue
            count = math.prod(attribute.shape)
            if count > 1 and count * longest > MOST_TEXT_BYTES:
                return [f"{path}: an attribute of {count} texts in a file that has one of {longest} bytes"]
            texts = np.empty(attribute.shape, attribute.dtype)
            attribute.read(texts)
            item_bytes += sum(len(text) for text in texts.flat)
            if (item_faults := faults_of_attributes(item_bytes, path)) or total_bytes + item_bytes > most_bytes:
                return item_faults or [f"more than {most_bytes} bytes of texts in attributes; fewer were expected"]
        total_bytes += item_bytes
    return []


def faults_of_kinds(items: Mapping[str, Any]) -> list[str]:
    """Return one line for each object of the run format that is not the expected group, table column or text."""
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
