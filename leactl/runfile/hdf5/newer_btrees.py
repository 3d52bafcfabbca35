"""Check B-trees of version 2, which index links, attributes and chunks in HDF5's newer formats, before HDF5 walks them.

Checksums cover them, but whoever makes a file makes its checksums. HDF5 trusts the number of records that a tree's
header says when it makes a table of attributes, which more records overflow, and walks a node once for each parent that
refers to it: a few kB may hold 1e18 records. So each node may be met once, and the records must be as many as said.
Chunks may lie in arrays instead, of which HDF5 looks at as many elements as their headers say (HDF5 file format 3.0:
III.A.2 the tree, III.G the heap of links and attributes, VII.C and VII.D the arrays).
"""

import struct
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from leactl.errors import InputError
from leactl.runfile.hdf5.swmr import checksum

NOWHERE: Final = (1 << 64) - 1
TREE: Final = struct.Struct(
    "<4sxBIHH2xQHQ"
)  # signature, type, size of a node and a record, depth, root, its records, all
HEAP: Final = struct.Struct("<4sxHH1xI8xQ")  # signature, bytes of an identifier, of filters, largest object, huge ones
HEAP_SIZE: Final = 142  # bytes before the checksum
LARGEST_BLOCK_AT: Final = 120
CHECKSUM: Final = 4  # bytes
NODE_HEAD: Final = 6  # bytes: signature, version, type
NODE_PREFIX: Final = 10  # bytes: the head and the checksum
RECORDS: Final = {5: 11, 6: 15, 8: 17, 9: 13}  # bytes of a record by type: links by name and order, attributes likewise
IDENTIFIERS: Final = {5: slice(4, 11), 6: slice(8, 15), 8: slice(8), 9: slice(8)}  # in a record
HUGE: Final = struct.Struct("<8xQQ")  # of an object outside the heap's blocks: length and number
HUGE_OBJECTS: Final = 1  # type of a tree
ARRAYS: Final = {b"FAHD": 8, b"EAHD": 44}  # fixed and extensible: where the header says how many elements there are
COUNT: Final = struct.Struct("<Q")
MOST_CHUNKS: Final = 1 << 22  # of an array; HDF5 looks at two million a second
DEEPEST: Final = 16  # levels; each multiplies the records by 8 or more
MOST_NODES: Final = 1 << 17  # of all trees, leaves included
MOST_RECORDS: Final = 1 << 17  # of one object's links or attributes
LARGEST_NODE: Final = 1 << 16  # bytes; HDF5 makes them of 512 and 2048
LARGEST_OBJECT: Final = 1 << 13  # bytes in a heap's blocks; HDF5 puts those above 4096 outside
LARGEST_HEAP_BLOCK: Final = 1 << 20  # bytes; HDF5's have 65,536 at most
MOST_HUGE: Final = 1 << 24  # bytes of all attributes and links outside the blocks


class TreeHeader(NamedTuple):
    """What a tree's header says."""

    kind: int
    node_size: int
    record_size: int
    depth: int
    root: int
    root_records: int
    records: int


class Branch(NamedTuple):
    """A node as its parent knows it."""

    address: int
    records: int


class NewerBTrees:
    """The B-trees of version 2 of a file, each node of which may be met once; `read` gives bytes at an address."""

    def __init__(self, read: Callable[[int, int], bytes]) -> None:
        self._read = read
        self._met: set[int] = set()
        self._nodes = self._huge_bytes = 0

    def check_index(self, heap: int, trees: list[int], hdf5_path: str) -> None:
        """Check the trees that index a heap of links or attributes, and what lies outside the heap's blocks.

        Raises
        ------
        InputError : HDF5 might never reach the end of a tree, overflow a table, or read more than is kept.
        """
        identifier_size, huge = self._check_heap(heap, hdf5_path)
        outside = 0  # bytes; of the index by name and the one by order, which refer to the same objects, the larger
        for address in trees:
            if (tree := self._header(address)) is None:
                continue
            if RECORDS.get(tree.kind) != tree.record_size or identifier_size != (7 if tree.kind in (5, 6) else 8):
                raise InputError(f"{hdf5_path}: damaged: the index of its members or attributes has other records")
            rows = self._walked(tree, hdf5_path)
            if huge:
                outside = max(outside, self._bytes_outside(tree, rows, huge))
        self._huge_bytes += outside
        if self._huge_bytes > MOST_HUGE:
            raise InputError(f"{hdf5_path}: more than {MOST_HUGE} bytes of large links or attributes in this file")

    def check_chunks(self, address: int, hdf5_path: str) -> None:
        """Check a tree or an array of chunks; the number of its records may grow while it is read.

        Raises
        ------
        InputError : HDF5 might never reach the end of the index.
        """
        head = self._read(address, max(ARRAYS.values()) + COUNT.size)
        at = ARRAYS.get(head[:4])
        if at is not None and len(head) >= at + COUNT.size and (count := COUNT.unpack_from(head, at)[0]) > MOST_CHUNKS:
            raise InputError(
                f"{hdf5_path}: {count} elements in the index of its chunks; at most {MOST_CHUNKS} were expected"
            )
        if (tree := self._header(address)) is not None:
            self._walked(tree, hdf5_path)

    def _header(self, address: int) -> TreeHeader | None:
        """A tree's header; None if there is none that is whole, which HDF5 reports itself."""
        head = self._read(address, TREE.size + CHECKSUM)
        if len(head) < TREE.size + CHECKSUM or not head.startswith(b"BTHD") or not is_whole(head):
            return None
        return TreeHeader(*TREE.unpack_from(head)[1:])

    def _walked(self, tree: TreeHeader, hdf5_path: str) -> list[list[Branch]]:
        """The nodes of a tree, level by level from the root down; leaves are not read."""
        is_counted = tree.kind in (HUGE_OBJECTS, *RECORDS)
        if is_counted and tree.records > MOST_RECORDS:
            raise InputError(f"{hdf5_path}: {tree.records} records in its index; at most {MOST_RECORDS} were expected")
        if tree.depth > DEEPEST or not 0 < tree.record_size < tree.node_size <= LARGEST_NODE:
            text = f"{tree.depth} levels of nodes of {tree.node_size} bytes and records of {tree.record_size}"
            raise InputError(
                f"{hdf5_path}: an index of {text}; at most {DEEPEST} of {LARGEST_NODE} bytes were expected"
            )
        if tree.root == NOWHERE:
            return []
        rows = [[Branch(tree.root, tree.root_records)]]
        for most, pointer_size, count_size in reversed(capacities(tree)):
            self._meet(rows, most, hdf5_path)
            if pointer_size:
                layout = tree.record_size, pointer_size, count_size
                rows.append([child for node in rows[-1] for child in self._children(node, *layout)])
        records = sum(node.records for row in rows for node in row)
        if is_counted and records != tree.records:
            raise InputError(f"{hdf5_path}: damaged: its index has {records} records and says {tree.records}")
        return rows

    def _meet(self, rows: list[list[Branch]], most: int, hdf5_path: str) -> None:
        """Meet the nodes of the lowest row so far."""
        addresses = {node.address for node in rows[-1]}
        self._nodes += len(rows[-1])
        if self._nodes > MOST_NODES:
            raise InputError(f"{hdf5_path}: more than {MOST_NODES} nodes in its index; fewer were expected")
        is_tree = len(addresses) == len(rows[-1]) and self._met.isdisjoint(addresses)
        if not is_tree or any(node.records > most for node in rows[-1]):
            raise InputError(f"{hdf5_path}: damaged: the index of its members, attributes or chunks is no tree")
        self._met |= addresses

    def _children(self, node: Branch, record_size: int, pointer_size: int, count_size: int) -> Iterator[Branch]:
        """The nodes below one; none if it is no inner node, which HDF5 reports itself."""
        begin = NODE_HEAD + node.records * record_size
        raw = self._read(node.address, begin + (node.records + 1) * pointer_size)
        if not raw.startswith(b"BTIN"):
            return
        for at in range(begin, len(raw) - pointer_size + 1, pointer_size):
            count = int.from_bytes(raw[at + 8 : at + 8 + count_size], "little")
            yield Branch(int.from_bytes(raw[at : at + 8], "little"), count)

    def _records(self, tree: TreeHeader, rows: list[list[Branch]]) -> Iterator[bytes]:
        """The records of walked nodes."""
        for node in (node for row in rows for node in row):
            raw = self._read(node.address, NODE_HEAD + node.records * tree.record_size)
            for at in range(NODE_HEAD, len(raw) - tree.record_size + 1, tree.record_size):
                yield raw[at : at + tree.record_size]

    def _check_heap(self, address: int, hdf5_path: str) -> tuple[int, dict[int, int]]:
        """Size of a heap's identifiers, and the lengths of the objects outside its blocks by number."""
        head = self._read(address, HEAP_SIZE + CHECKSUM)
        if len(head) < HEAP_SIZE + CHECKSUM or not head.startswith(b"FRHP"):
            return 0, {}
        _, identifier_size, filters_size, largest, huge = HEAP.unpack_from(head)
        if filters_size:
            raise InputError(f"{hdf5_path}: its links or attributes are packed; plain ones were expected")
        (block,) = COUNT.unpack_from(head, LARGEST_BLOCK_AT)
        if is_whole(head) and (largest > LARGEST_OBJECT or block > LARGEST_HEAP_BLOCK):
            text = f"a heap for objects of {largest} bytes in blocks of {block}"
            raise InputError(f"{hdf5_path}: {text}; at most {LARGEST_OBJECT} and {LARGEST_HEAP_BLOCK} were expected")
        if huge == NOWHERE or (tree := self._header(huge)) is None:
            return identifier_size, {}
        if (tree.kind, tree.record_size) != (HUGE_OBJECTS, HUGE.size):
            raise InputError(f"{hdf5_path}: damaged: the index of its large links or attributes has other records")
        longest: dict[int, int] = {}
        for record in self._records(tree, self._walked(tree, hdf5_path)):
            length, number = HUGE.unpack(record)
            longest[number] = max(length, longest.get(number, 0))
        return identifier_size, longest

    def _bytes_outside(self, tree: TreeHeader, rows: list[list[Branch]], huge: dict[int, int]) -> int:
        """What an index refers to outside a heap's blocks, once for each reference."""
        total = 0
        for record in self._records(tree, rows):
            identifier = record[IDENTIFIERS[tree.kind]]
            if identifier[0] >> 4 & 3 == 1:
                total += huge.get(int.from_bytes(identifier[1:], "little"), 0)
        return total


def capacities(tree: TreeHeader) -> list[tuple[int, int, int]]:
    """Most records of a node, size of a pointer to a child and of the number of records in it, from the leaves up."""
    most = (tree.node_size - NODE_PREFIX) // tree.record_size
    count_size = bytes_for(most)
    below, below_size = most, 0  # records of a whole branch, and the bytes that hold their number
    levels = [(most, 0, 0)]
    for _ in range(tree.depth):
        pointer_size = 8 + count_size + below_size
        most = max(0, tree.node_size - NODE_PREFIX - pointer_size) // (tree.record_size + pointer_size)
        below = (most + 1) * below + most
        below_size = bytes_for(below)
        levels.append((most, pointer_size, count_size))
    return levels


def bytes_for(number: int) -> int:
    """Bytes of a number up to `number`, as HDF5 counts them."""
    return max(0, number.bit_length() - 1) // 8 + 1


def is_whole(head: bytes) -> bool:
    """Whether the last four bytes are the checksum of those before."""
    return checksum(head[:-CHECKSUM]) == int.from_bytes(head[-CHECKSUM:], "little")
