"""Check B-trees of version 2, which index links, attributes and chunks in HDF5's newer formats, before HDF5 walks them.

Checksums cover these trees, but a malicious file may have valid checksums. HDF5 trusts the number of records in a
tree's header when it allocates a table of attributes, which more records overflow, and walks a node once for each
parent that refers to it, so that a few kB may stand for 1e18 records. Therefore no node may be reached twice, and the
number of records must equal that of the header. Arrays may index chunks instead; HDF5 reads as many of their elements
as their headers announce (HDF5 file format 3.0: III.A.2 the tree, III.G the heap of links and attributes, VII.C and
VII.D the arrays).
"""

import struct
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from leactl.errors import InputError
from leactl.runfile.hdf5.swmr import checksum

UNDEFINED_ADDRESS: Final = (1 << 64) - 1
# signature, type, size of a node and of a record, depth, address of the root, records of the root and of the tree
TREE: Final = struct.Struct("<4sxBIHH2xQHQ")
# signature, size of an identifier and of the filters, largest object in a block, address of the tree of huge objects
HEAP: Final = struct.Struct("<4sxHH1xI8xQ")
HEAP_SIZE: Final = 142  # bytes before the checksum
LARGEST_BLOCK_AT: Final = 120  # offset of the size of the largest block in a heap's header
CHECKSUM: Final = 4  # bytes
NODE_HEAD: Final = 6  # bytes: signature, version, type
NODE_PREFIX: Final = 10  # bytes: the head and the checksum
RECORDS: Final = {5: 11, 6: 15, 8: 17, 9: 13}  # bytes of a record by type: links by name and order, attributes likewise
IDENTIFIERS: Final = {5: slice(4, 11), 6: slice(8, 15), 8: slice(8), 9: slice(8)}  # bytes of the identifier in a record
HUGE: Final = struct.Struct("<8xQQ")  # record of a huge object, stored outside the heap's blocks: length and number
HUGE_OBJECTS: Final = 1  # type of the tree of huge objects
ARRAYS: Final = {b"FAHD": 8, b"EAHD": 44}  # offset of the number of elements in the header of a fixed, extensible array
COUNT: Final = struct.Struct("<Q")
MOST_CHUNKS: Final = 1 << 22  # elements of an array; HDF5 reads two million a second
MOST_LEVELS: Final = 16  # of a tree; each multiplies the records by 8 or more
MOST_NODES: Final = 1 << 17  # of all trees, including leaves
MOST_RECORDS: Final = 1 << 17  # of the links or attributes of one object
LARGEST_NODE: Final = 1 << 16  # bytes; HDF5 creates nodes of 512 and 2048
LARGEST_OBJECT: Final = 1 << 13  # bytes in a heap's blocks; HDF5 stores objects above 4096 bytes outside
LARGEST_HEAP_BLOCK: Final = 1 << 20  # bytes; HDF5 creates blocks of at most 65,536
MOST_HUGE_BYTES: Final = 1 << 24  # bytes of all huge attributes and links


class TreeHeader(NamedTuple):
    """Header of a tree of version 2."""

    kind: int
    node_size: int  # bytes
    record_size: int  # bytes
    depth: int  # levels below the root
    root: int  # address
    root_records: int  # records in the root node
    records: int  # records in the whole tree


class Branch(NamedTuple):
    """Address of a node, and number of its records by its parent."""

    address: int
    records: int


class NewerBTrees:
    """Checker of the B-trees of version 2 of a file; no node may be reached twice.

    Parameters
    ----------
    read : function that returns the bytes of the file at an address, by address and number of bytes.
    """

    def __init__(self, read: Callable[[int, int], bytes]) -> None:
        self._read = read
        self._visited_nodes: set[int] = set()
        self._node_count = self._huge_bytes = 0

    def check_index(self, heap: int, trees: list[int], hdf5_path: str) -> None:
        """Check the trees that index a heap of links or attributes, and the size of its huge objects.

        Raises
        ------
        InputError : HDF5 might never reach the end of a tree, overflow a table, or exceed the bounds of this module.
        """
        identifier_size, huge_lengths = self._check_heap(heap, hdf5_path)
        index_bytes = 0  # the larger of both indexes, by name and by order, which refer to the same objects
        for address in trees:
            if (tree := self._header(address)) is None:
                continue
            if RECORDS.get(tree.kind) != tree.record_size or identifier_size != (7 if tree.kind in (5, 6) else 8):
                raise InputError(f"{hdf5_path}: damaged: the index of its members or attributes has other records")
            levels = self._node_levels(tree, hdf5_path)
            if huge_lengths:
                index_bytes = max(index_bytes, self._huge_bytes_of(tree, levels, huge_lengths))
        self._huge_bytes += index_bytes
        if self._huge_bytes > MOST_HUGE_BYTES:
            raise InputError(
                f"{hdf5_path}: more than {MOST_HUGE_BYTES} bytes of large links or attributes in this file"
            )

    def check_chunks(self, address: int, hdf5_path: str) -> None:
        """Check a tree or an array that indexes chunks; the number of its records may grow while it is read.

        Raises
        ------
        InputError : HDF5 might never reach the end of the index.
        """
        header_bytes = self._read(address, max(ARRAYS.values()) + COUNT.size)
        count_offset = ARRAYS.get(header_bytes[:4])
        if (
            count_offset is not None
            and len(header_bytes) >= count_offset + COUNT.size
            and (count := COUNT.unpack_from(header_bytes, count_offset)[0]) > MOST_CHUNKS
        ):
            raise InputError(
                f"{hdf5_path}: {count} elements in the index of its chunks; at most {MOST_CHUNKS} were expected"
            )
        if (tree := self._header(address)) is not None:
            self._node_levels(tree, hdf5_path)

    def _header(self, address: int) -> TreeHeader | None:
        """Return the header of a tree; None if it is absent or has a wrong checksum, which HDF5 itself reports."""
        header_bytes = self._read(address, TREE.size + CHECKSUM)
        if (
            len(header_bytes) < TREE.size + CHECKSUM
            or not header_bytes.startswith(b"BTHD")
            or not has_valid_checksum(header_bytes)
        ):
            return None
        return TreeHeader(*TREE.unpack_from(header_bytes)[1:])

    def _node_levels(self, tree: TreeHeader, hdf5_path: str) -> list[list[Branch]]:
        """Return the nodes of a tree, level by level from the root down, without reading the leaves.

        Raises
        ------
        InputError : the tree is too deep or too large, a node is reached twice, or the number of records is wrong.
        """
        is_counted = tree.kind in (HUGE_OBJECTS, *RECORDS)
        if is_counted and tree.records > MOST_RECORDS:
            raise InputError(f"{hdf5_path}: {tree.records} records in its index; at most {MOST_RECORDS} were expected")
        if tree.depth > MOST_LEVELS or not 0 < tree.record_size < tree.node_size <= LARGEST_NODE:
            text = f"{tree.depth} levels of nodes of {tree.node_size} bytes and records of {tree.record_size}"
            raise InputError(
                f"{hdf5_path}: an index of {text}; at most {MOST_LEVELS} of {LARGEST_NODE} bytes were expected"
            )
        if tree.root == UNDEFINED_ADDRESS:
            return []
        levels = [[Branch(tree.root, tree.root_records)]]
        for capacity, pointer_size, count_size in reversed(capacities(tree)):
            self._mark_level(levels, capacity, hdf5_path)
            if pointer_size:
                layout = tree.record_size, pointer_size, count_size
                levels.append([child for node in levels[-1] for child in self._children(node, *layout)])
        records = sum(node.records for level in levels for node in level)
        if is_counted and records != tree.records:
            raise InputError(f"{hdf5_path}: damaged: its index has {records} records and says {tree.records}")
        return levels

    def _mark_level(self, levels: list[list[Branch]], capacity: int, hdf5_path: str) -> None:
        """Mark the nodes of the last level as reached.

        Raises
        ------
        InputError : a node was reached before, has more records than `capacity`, or there are too many nodes.
        """
        addresses = {node.address for node in levels[-1]}
        self._node_count += len(levels[-1])
        if self._node_count > MOST_NODES:
            raise InputError(f"{hdf5_path}: more than {MOST_NODES} nodes in its index; fewer were expected")
        is_tree = len(addresses) == len(levels[-1]) and self._visited_nodes.isdisjoint(addresses)
        if not is_tree or any(node.records > capacity for node in levels[-1]):
            raise InputError(f"{hdf5_path}: damaged: the index of its members, attributes or chunks is no tree")
        self._visited_nodes |= addresses

    def _children(self, node: Branch, record_size: int, pointer_size: int, count_size: int) -> Iterator[Branch]:
        """Yield the children of a node; none if it is not an inner node, which HDF5 itself reports."""
        pointers_offset = NODE_HEAD + node.records * record_size
        node_bytes = self._read(node.address, pointers_offset + (node.records + 1) * pointer_size)
        if not node_bytes.startswith(b"BTIN"):
            return
        for offset in range(pointers_offset, len(node_bytes) - pointer_size + 1, pointer_size):
            count = int.from_bytes(node_bytes[offset + 8 : offset + 8 + count_size], "little")
            yield Branch(int.from_bytes(node_bytes[offset : offset + 8], "little"), count)

    def _records(self, tree: TreeHeader, levels: list[list[Branch]]) -> Iterator[bytes]:
        """Yield the records of the nodes in `levels`, as bytes."""
        for node in (node for level in levels for node in level):
            node_bytes = self._read(node.address, NODE_HEAD + node.records * tree.record_size)
            for offset in range(NODE_HEAD, len(node_bytes) - tree.record_size + 1, tree.record_size):
                yield node_bytes[offset : offset + tree.record_size]

    def _check_heap(self, address: int, hdf5_path: str) -> tuple[int, dict[int, int]]:
        """Return the size of a heap's identifiers, and the lengths of its huge objects by number.

        Raises
        ------
        InputError : the heap is compressed, or its objects, blocks or tree of huge objects are not as expected.
        """
        header_bytes = self._read(address, HEAP_SIZE + CHECKSUM)
        if len(header_bytes) < HEAP_SIZE + CHECKSUM or not header_bytes.startswith(b"FRHP"):
            return 0, {}
        _, identifier_size, filters_size, largest_object, huge_tree = HEAP.unpack_from(header_bytes)
        if filters_size:
            raise InputError(f"{hdf5_path}: its links or attributes are packed; plain ones were expected")
        (largest_block,) = COUNT.unpack_from(header_bytes, LARGEST_BLOCK_AT)
        if has_valid_checksum(header_bytes) and (largest_object > LARGEST_OBJECT or largest_block > LARGEST_HEAP_BLOCK):
            text = f"a heap for objects of {largest_object} bytes in blocks of {largest_block}"
            raise InputError(f"{hdf5_path}: {text}; at most {LARGEST_OBJECT} and {LARGEST_HEAP_BLOCK} were expected")
        if huge_tree == UNDEFINED_ADDRESS or (tree := self._header(huge_tree)) is None:
            return identifier_size, {}
        if (tree.kind, tree.record_size) != (HUGE_OBJECTS, HUGE.size):
            raise InputError(f"{hdf5_path}: damaged: the index of its large links or attributes has other records")
        lengths: dict[int, int] = {}
        for record in self._records(tree, self._node_levels(tree, hdf5_path)):
            length, number = HUGE.unpack(record)
            lengths[number] = max(length, lengths.get(number, 0))
        return identifier_size, lengths

    def _huge_bytes_of(self, tree: TreeHeader, levels: list[list[Branch]], huge_lengths: dict[int, int]) -> int:
        """Return the bytes of the huge objects to which an index refers, once for each reference."""
        total = 0
        for record in self._records(tree, levels):
            identifier = record[IDENTIFIERS[tree.kind]]
            if identifier[0] >> 4 & 3 == 1:
                total += huge_lengths.get(int.from_bytes(identifier[1:], "little"), 0)
        return total


def capacities(tree: TreeHeader) -> list[tuple[int, int, int]]:
    """Return, for each level from the leaves up, the largest number of records of a node and two sizes [bytes].

    The sizes are those of a pointer to a child and, within it, of the number of the child's records; 0 for leaves.
    """
    capacity = (tree.node_size - NODE_PREFIX) // tree.record_size
    count_size = bytes_for(capacity)
    branch_records, branch_count_size = capacity, 0  # records of a whole branch, and the bytes that hold their number
    levels = [(capacity, 0, 0)]
    for _ in range(tree.depth):
        pointer_size = 8 + count_size + branch_count_size
        capacity = max(0, tree.node_size - NODE_PREFIX - pointer_size) // (tree.record_size + pointer_size)
        branch_records = (capacity + 1) * branch_records + capacity
        branch_count_size = bytes_for(branch_records)
        levels.append((capacity, pointer_size, count_size))
    return levels


def bytes_for(number: int) -> int:
    """Return the bytes that HDF5 uses to store numbers up to `number`."""
    return max(0, number.bit_length() - 1) // 8 + 1


def has_valid_checksum(header_bytes: bytes) -> bool:
    """Return whether the last four bytes are the checksum of those before."""
    return checksum(header_bytes[:-CHECKSUM]) == int.from_bytes(header_bytes[-CHECKSUM:], "little")
