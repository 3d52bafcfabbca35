"""Check B-trees of version 1, which index groups and chunks in HDF5's oldest format, before HDF5 walks them.

No checksum covers their nodes, and HDF5 follows their addresses without a check: a node that is its own child crashes
the process, and a node that is its own sibling makes HDF5 loop for ever. So does a cyclic list of free blocks in the
heap of a group's names. `newer_btrees` checks the trees of newer formats. An object's header has the address of its
tree (HDF5 file format 3.0: III.A.1 the tree, III.D the heap, IV.A the header and its messages).
"""

import struct
from collections.abc import Iterator
from typing import BinaryIO, Final, NamedTuple

from leactl.errors import InputError
from leactl.runfile.hdf5.newer_btrees import UNDEFINED_ADDRESS, NewerBTrees
from leactl.runfile.hdf5.text_heaps import bytes_at

LAYOUT, CONTINUATION, SYMBOL_TABLE = 0x08, 0x10, 0x11  # types of messages in a header
LINK_INFO, ATTRIBUTE_INFO = 0x02, 0x15
SIZE_OF_LAST_NUMBER: Final = {LINK_INFO: 8, ATTRIBUTE_INFO: 2}  # bytes, where links or attributes are numbered
INDEX_SETTINGS: Final = {3: 1, 4: 5, 5: 6}  # bytes of settings before the address, by the type of a chunk index
CHUNKED: Final = 2  # class of a dataset's layout
GROUP_NODE, CHUNK_NODE = 0, 1  # types of trees
LARGEST_OFFSET: Final = 1 << 62  # largest byte offset to which the system can seek
HEAP: Final = struct.Struct("<4s4xQQQ")  # signature, size of the names, first free block in them, their address
NODE: Final = struct.Struct("<4sBBHQQ")  # signature, type, level, children, left and right sibling
ADDRESS: Final = struct.Struct("<Q")
MOST_MESSAGES: Final = 1 << 19  # in all headers: 50 for each of 10,000 objects
MOST_HEADER_BYTES: Final = 1 << 26  # of all headers, which contain attributes and the smallest datasets
MOST_NODES: Final = 1 << 17  # of one tree; HDF5 fills each with at least 32 chunks, four million in all


class HeaderMessage(NamedTuple):
    """A message of an object header."""

    kind: int  # type of the message
    body: bytes


class Root(NamedTuple):
    """Type and root address of a tree of version 1."""

    kind: int
    address: int
    key_size: int  # bytes before each child's address


class DenseStorage(NamedTuple):
    """Addresses of a heap of links or attributes, and of the trees of version 2 that index it."""

    heap: int
    name_index: int
    order_index: int = UNDEFINED_ADDRESS  # by the order of creation

    @property
    def indices(self) -> list[int]:
        """Addresses of the trees that exist."""
        return [address for address in (self.name_index, self.order_index) if address != UNDEFINED_ADDRESS]


class TreeNode(NamedTuple):
    """Header of a tree's node."""

    level: int  # 0 for a leaf
    children: int  # number of children
    left: int  # address of the left sibling
    right: int  # address of the right sibling


class BTrees:
    """Checker of the B-trees of a file whose addresses count from the byte `base`; no node may be reached twice."""

    def __init__(self, raw: BinaryIO, base: int) -> None:
        self._raw, self._base = raw, base
        self._checked_headers: set[int] = set()  # addresses; an object with several names is checked once
        self._visited_nodes: set[int] = set()
        self._messages_read = self._header_bytes = 0
        self._newer = NewerBTrees(self._bytes)

    def check(self, header: int, hdf5_path: str) -> None:
        """Check the trees to which the object header at an address refers.

        HDF5 itself reports an address at which there is no tree.

        Raises
        ------
        InputError : HDF5 might never reach the end of a tree.
        """
        if header in self._checked_headers:
            return
        self._checked_headers.add(header)
        for message in self._messages(header):
            if (root := v1_tree_root(message)) is not None and root.address != UNDEFINED_ADDRESS:
                self._check_tree(root, hdf5_path)
            if message.kind == SYMBOL_TABLE and len(message.body) >= 16:
                self._check_heap(ADDRESS.unpack_from(message.body, 8)[0], hdf5_path)
            dense = dense_storage_addresses(message)
            if dense is not None and dense.heap != UNDEFINED_ADDRESS:
                self._newer.check_index(dense.heap, dense.indices, hdf5_path)
            if (index := chunk_index_address(message)) is not None and index != UNDEFINED_ADDRESS:
                self._newer.check_chunks(index, hdf5_path)

    def _check_heap(self, heap: int, hdf5_path: str) -> None:
        """Follow the list of free blocks in the heap of a group's names.

        Raises
        ------
        InputError : the list is cyclic or too long.
        """
        if len(header_bytes := self._bytes(heap, HEAP.size)) < HEAP.size:
            return
        signature, size, free_offset, names_address = HEAP.unpack(header_bytes)
        visited_offsets: set[int] = set()
        while signature == b"HEAP" and free_offset + ADDRESS.size <= size:
            if free_offset in visited_offsets or len(visited_offsets) > MOST_NODES:
                raise InputError(f"{hdf5_path}: damaged: the free space among the names of its members has no end")
            visited_offsets.add(free_offset)
            block = self._bytes(names_address + free_offset, ADDRESS.size)
            free_offset = ADDRESS.unpack(block)[0] if len(block) == ADDRESS.size else size

    def _check_tree(self, root: Root, hdf5_path: str) -> None:
        """Check the nodes of a tree level by level, from the root down.

        Raises
        ------
        InputError : a node is reached twice, siblings are out of order, levels differ, or there are too many nodes.
        """
        damage_error = InputError(f"{hdf5_path}: damaged: the index of its members or chunks is no tree")
        level_addresses, level = [root.address], None
        node_count = 0
        while level_addresses:
            if (node_count := node_count + len(level_addresses)) > MOST_NODES:
                raise InputError(f"{hdf5_path}: more than {MOST_NODES} nodes in its index; fewer were expected")
            positions = {address: position for position, address in enumerate(level_addresses)}
            if len(positions) < len(level_addresses) or not self._visited_nodes.isdisjoint(positions):
                raise damage_error
            self._visited_nodes |= positions.keys()
            next_addresses: list[int] = []
            for position, address in enumerate(level_addresses):
                if (node := self._node(address, root.kind)) is None:
                    continue
                level = node.level if level is None else level
                left_position = -1 if node.left == UNDEFINED_ADDRESS else positions.get(node.left, position)
                right_position = (
                    len(level_addresses) if node.right == UNDEFINED_ADDRESS else positions.get(node.right, position)
                )
                if node.level != level or not left_position < position < right_position:
                    raise damage_error
                if level and len(next_addresses) + node.children <= MOST_NODES:
                    next_addresses += self._children(address, node.children, root.key_size)
                elif level:
                    raise InputError(f"{hdf5_path}: more than {MOST_NODES} nodes in its index; fewer were expected")
            level_addresses, level = next_addresses, (level or 0) - 1

    def _node(self, address: int, kind: int) -> TreeNode | None:
        """Return the node at an address; None if there is none of this kind, which HDF5 itself reports."""
        header_bytes = self._bytes(address, NODE.size)
        if len(header_bytes) < NODE.size:
            return None
        signature, node_kind, level, children, left, right = NODE.unpack(header_bytes)
        return TreeNode(level, children, left, right) if (signature, node_kind) == (b"TREE", kind) else None

    def _children(self, address: int, count: int, key_size: int) -> Iterator[int]:
        """Yield the addresses of the `count` children of the node at an address."""
        entry_size = key_size + ADDRESS.size
        entries = self._bytes(address + NODE.size, count * entry_size)
        for offset in range(key_size, len(entries) - ADDRESS.size + 1, entry_size):
            yield ADDRESS.unpack_from(entries, offset)[0]

    def _bytes(self, address: int, count: int) -> bytes:
        """Read `count` bytes from an address; fewer if the file ends before."""
        return bytes_at(self._raw, self._base + address, count) if address < LARGEST_OFFSET else b""

    def _messages(self, header: int) -> Iterator[HeaderMessage]:
        """Yield the messages of an object header of version 1 or 2, including those of its continuation blocks.

        Raises
        ------
        InputError : the headers of the file have too many messages or bytes.
        """
        prefix = self._bytes(header, 64)
        if prefix.startswith(b"OHDR\x02"):
            flags = prefix[5]
            # flag 0x20: times are stored; flag 0x10: limits of attributes are stored
            position = 6 + (16 if flags & 0x20 else 0) + (4 if flags & 0x10 else 0)
            length_size = 1 << (flags & 3)
            blocks = [
                (header + position + length_size, int.from_bytes(prefix[position : position + length_size], "little"))
            ]
            # flag 0x04: the order of creation is stored
            header_format = struct.Struct("<BHB2x" if flags & 0x04 else "<BHB")
            signature_size = checksum_size = 4
        elif prefix.startswith(b"\x01"):
            blocks = [(header + 16, int.from_bytes(prefix[8:12], "little"))]
            header_format = struct.Struct("<HHB3x")
            signature_size = checksum_size = 0
        else:
            return
        limit_error = InputError(f"headers of more than {MOST_MESSAGES} entries or {MOST_HEADER_BYTES} bytes")
        for position, length in blocks:  # the loop appends further blocks
            self._header_bytes += length
            if self._header_bytes > MOST_HEADER_BYTES:
                raise limit_error
            block = self._bytes(position, length)
            offset = 0
            while offset + header_format.size <= len(block):
                kind, body_size, _flags = header_format.unpack_from(block, offset)
                offset += header_format.size
                body = block[offset : offset + body_size]
                offset += body_size
                if kind == CONTINUATION and len(body) >= 16:
                    next_block, next_length = struct.unpack_from("<QQ", body)
                    blocks.append((next_block + signature_size, max(0, next_length - signature_size - checksum_size)))
                self._messages_read += 1
                if self._messages_read > MOST_MESSAGES:
                    raise limit_error
                yield HeaderMessage(kind, body)


def v1_tree_root(message: HeaderMessage) -> Root | None:
    """Return the root of the tree of version 1 to which a message refers; None if it refers to none."""
    body = message.body
    if message.kind == SYMBOL_TABLE and len(body) >= 16:
        return Root(GROUP_NODE, ADDRESS.unpack_from(body)[0], 8)
    if message.kind != LAYOUT or len(body) < 16:
        return None
    if body[0] == 3 and body[1] == CHUNKED:
        dimensions, address_offset = body[2], 3
    elif body[0] in (1, 2) and body[2] == CHUNKED:
        dimensions, address_offset = body[1], 8
    else:
        return None
    # a key has a chunk's size, the mask of skipped filters, and its offset in each dimension and in the value
    return Root(CHUNK_NODE, ADDRESS.unpack_from(body, address_offset)[0], 8 + 8 * dimensions)


def dense_storage_addresses(message: HeaderMessage) -> DenseStorage | None:
    """Return the heap and the indices of links or attributes to which a message refers; None if it refers to none."""
    body = message.body
    if message.kind not in SIZE_OF_LAST_NUMBER or len(body) < 2:
        return None
    first_byte = 2 + (SIZE_OF_LAST_NUMBER[message.kind] if body[1] & 1 else 0)
    count = 3 if body[1] & 2 else 2  # flag 2: there is also a tree by the order of creation
    end_byte = first_byte + count * ADDRESS.size
    if end_byte > len(body):
        return None
    return DenseStorage(*(address for (address,) in ADDRESS.iter_unpack(body[first_byte:end_byte])))


def chunk_index_address(message: HeaderMessage) -> int | None:
    """Return the address of the array or the tree of version 2 that indexes chunks; None if there is none."""
    body = message.body
    if message.kind != LAYOUT or len(body) < 5 or body[0] < 4 or body[1] != CHUNKED:
        return None
    type_offset = 5 + body[3] * body[4]  # after the chunk's length in each dimension
    address_offset = (
        type_offset + 1 + INDEX_SETTINGS.get(body[type_offset], len(body)) if type_offset < len(body) else type_offset
    )
    return int(ADDRESS.unpack_from(body, address_offset)[0]) if address_offset + ADDRESS.size <= len(body) else None
