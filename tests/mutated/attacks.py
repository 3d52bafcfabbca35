"""Run files of a stranger who means ill, each made from a sound one: what leads out of the file, and what swells.

`outside` is a folder with what must not be touched: `secret.h5` and `secret.raw`, whose every value is `SECRET`, and
the FIFO `fifo`, which holds whoever opens it.
"""

import os
import struct
import zlib
from functools import cache

import h5py
import numpy as np

from leactl.runfile import layout
from leactl.runfile.hdf5.text_heaps import HEAD, HEADER, OBJECT
from leactl.runfile.summary import RECORDING
from tests.runfile.specimen import unseal

OF_SCALES = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST")  # HDF5's own
SECRET = 31337.4242
ROWS = 1000  # of the files outside


def make_outside(folder):
    folder.mkdir()
    with h5py.File(folder / "secret.h5", "w") as file:
        file["streams/loop/time"] = np.arange(ROWS) + SECRET
        file["streams/loop/test_iq"] = np.full(ROWS, SECRET)
        file["time"] = np.arange(ROWS) + SECRET
        file["text"] = f"{SECRET}"
    np.full(ROWS, SECRET).tofile(folder / "secret.raw")
    os.mkfifo(folder / "fifo")
    return folder


def place(file, at):
    """Free the place of an object and return it."""
    if at in file:
        del file[at]
    return at


def keeping(at, attack):
    """Give what then stands in a dataset's place its attributes, without which nobody would look at it."""

    def kept(file, outside):
        before = {name: file[at].attrs[name] for name in file[at].attrs if name not in OF_SCALES}
        attack(file, outside)
        for name, value in before.items():
            file[at].attrs[name] = value

    return kept


def linked(at, link):
    def attack(file, outside):
        file[place(file, at)] = link(outside)

    return attack


def stored_outside(at, name, rows=ROWS):
    def attack(file, outside):
        file.create_dataset(place(file, at), (rows,), "f8", external=[(str(outside / name), 0, h5py.h5f.UNLIMITED)])

    return attack


def virtual(at, source):
    def attack(file, outside):
        mapped = h5py.VirtualLayout((ROWS,), "f8")
        name = "." if source == "." else str(outside / source)
        mapped[:] = h5py.VirtualSource(name, "time", (ROWS,), "f8")
        file.create_virtual_dataset(place(file, at), mapped, fillvalue=0.0)

    return attack


def announced(at, rows, **storage):
    def attack(file, outside):
        file.create_dataset(place(file, at), (rows,), "f8", **storage)

    return keeping(at, attack)


CHUNKED = {"chunks": (4096,), "maxshape": (None,)}
PACKED = {**CHUNKED, "compression": "gzip"}


def one_packed_chunk(rows, at="streams/loop/test_iq", filters=1):
    """One chunk of so many zeros, packed as often as is said."""

    def attack(file, outside):
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk((rows,))
        for _ in range(filters):
            plist.set_deflate(9)
        space = h5py.h5s.create_simple((rows,), (h5py.h5s.UNLIMITED,))
        dataset = h5py.h5d.create(file.id, place(file, at).encode(), h5py.h5t.NATIVE_DOUBLE, space, plist)
        packed = zeros_packed(8 * rows)
        for _ in range(filters - 1):
            packed = zlib.compress(packed, 9)
        dataset.write_direct_chunk((0,), packed)

    return keeping(at, attack)


@cache
def zeros_packed(size):
    deflate = zlib.compressobj(6)
    block = bytes(1 << 20)
    parts = [deflate.compress(block) for _ in range(size >> 20)]
    return b"".join(parts) + deflate.flush()


def more_than_its_chunk(at):
    """A chunk of 512 KiB whose packed bytes, no more than these, give 512 MiB."""

    def attack(file, outside):
        dataset = file.create_dataset(
            place(file, at), (ROWS,), "f8", chunks=(1 << 16,), maxshape=(None,), compression=9
        )
        dataset.id.write_direct_chunk((0,), zeros_packed(1 << 29))

    return keeping(at, attack)


def many_packed(rows, at="streams/loop/test_iq", chunk=1 << 16):
    def attack(file, outside):
        dataset = file.create_dataset(place(file, at), (rows,), "f8", chunks=(chunk,), maxshape=(None,), compression=9)
        packed = zlib.compress(bytes(8 * chunk), 9)
        for start in range(0, rows, chunk):
            dataset.id.write_direct_chunk((start,), packed)

    return keeping(at, attack)


def texts_again_and_again(at, count, size):
    """A column of texts that are all the same one, which the file holds once."""

    def attack(file, outside):
        texts = np.array(["x" * size, *["y"] * (count - 1)], layout.TEXT)
        file.create_dataset(place(file, at), data=texts, dtype=layout.TEXT)
        file.flush()
        offset = file[at].id.get_offset()
        with open(file.filename, "r+b") as raw:
            raw.seek(offset)
            first = raw.read(16)
            raw.seek(offset)
            raw.write(first * count)

    return attack


def attribute_again_and_again(count, size, dtype, make, at="more"):
    """The like in an attribute, in the oldest format, in which no checksum covers it; `make` makes a value."""

    def attack(file, outside):
        values = np.empty(count, object)
        for number in range(count):
            values[number] = make(size if not number else 1)
        file.require_group(at).attrs.create("more", values, dtype=dtype)
        file.flush()

    def patch(path):
        raw = path.read_bytes()
        at = 0
        large = None
        while (at := raw.find(HEAD, at)) >= 0:
            begin, end = at + HEADER.size, at + HEADER.unpack_from(raw, at)[1]
            while begin + OBJECT.size <= end:
                number, _, _, length = OBJECT.unpack_from(raw, begin)
                if number and length == size:
                    large = struct.pack("<LQL", size, at, number)
                begin += length if not number else OBJECT.size + -(-length // 8) * 8
                if not number:
                    break
            at += 8
        where = raw.index(large)
        path.write_bytes(raw[:where] + large * count + raw[where + 16 * count :])

    attack.patch = patch
    attack.oldest = True
    return attack


def arrays_in_one_another():
    """A type whose header takes 24 bytes for each array."""
    made = h5py.h5t.NATIVE_DOUBLE
    for _ in range(2000):
        made = h5py.h5t.array_create(made, (1,))
    return made


def nested_arrays_of_an_attribute(file, outside):
    h5py.h5a.create(file.id, b"more", arrays_in_one_another(), h5py.h5s.create(h5py.h5s.SCALAR))


def nested_arrays(file, outside):
    h5py.h5d.create(file.id, b"more", arrays_in_one_another(), h5py.h5s.create(h5py.h5s.SCALAR))


def long_text_attribute(size, at="/"):
    def attack(file, outside):
        file[at].attrs["operator"] = "x" * size

    return attack


def holds_itself(file, outside):
    file["streams/loop/again"] = file["streams"]


def ladder(file, outside):
    """Two names for each group of a chain: twice as many paths with each."""
    group = file.create_group("streams/ladder")
    for _ in range(7):
        below = group.create_group("0")
        for number in range(1, 10):
            group[str(number)] = below
        group = below


def deep(file, outside):
    group = file["streams"]
    for _ in range(5000):
        group = group.create_group("g")


def crowd(file, outside):
    group = file.create_group("streams/crowd")
    for number in range(30_000):
        group.create_group(f"{number}")


def names(file, outside):
    """As many links as fit, none of which is an object."""
    group = file.create_group("setup2")
    for number in range(30_000):
        group[f"{number}"] = h5py.SoftLink("/nowhere")


def long_name_of_every_link(link):
    """9000 links whose names in the oldest format, in which no checksum covers them, are all one of 60 kB."""

    def attack(file, outside):
        group = file.create_group("more")
        group["l" * 60_000] = link(file)  # first, where the names of other groups stand in their own heaps
        for number in range(9000):
            group[f"k{number:05}"] = link(file)

    def patch(path):
        raw = bytearray(path.read_bytes())
        long = raw.index(b"l" * 60_000)
        heaps = [struct.unpack_from("<QQQ", raw, at + 8) for at in places(raw, b"HEAP")]
        names = next(begin for size, _, begin in heaps if begin < long < begin + size)
        for node in places(raw, b"SNOD"):
            for entry in range(node + 8, node + 8 + 40 * struct.unpack_from("<H", raw, node + 6)[0], 40):
                at = names + struct.unpack_from("<Q", raw, entry)[0]
                if raw[at : at + 1] == b"k" and raw[at + 6 : at + 7] == b"\0":
                    struct.pack_into("<Q", raw, entry, long - names)
        path.write_bytes(raw)

    attack.patch = patch
    attack.oldest = True
    return attack


def places(raw, signature):
    """Where a signature stands in a file."""
    at = raw.find(signature)
    while at >= 0:
        yield at
        at = raw.find(signature, at + 1)


def index_without_end(kind, level, change):
    """Nodes of the oldest format's index of groups (0) or of chunks (1) lead to themselves."""

    def attack(file, outside):
        file.create_dataset("more", data=np.ones(20_000), chunks=(100,))
        for number in range(2000):
            file[f"crowd/{number}"] = file["setup"]

    def patch(path):
        raw = bytearray(path.read_bytes())
        nodes = [at for at in places(raw, b"TREE") if (raw[at + 4], raw[at + 5]) == (kind, level)]
        for at in nodes:
            change(raw, at)
        assert nodes
        path.write_bytes(raw)

    attack.patch = patch
    attack.oldest = True
    return attack


def free_block_that_follows_itself(file, outside):
    """In the heap of a group's names, in the oldest format."""


def free_for_ever(path):
    raw = bytearray(path.read_bytes())
    for at in places(raw, b"HEAP"):
        size, free, names = struct.unpack_from("<QQQ", raw, at + 8)
        if free < size:
            struct.pack_into("<Q", raw, names + free, free)
    path.write_bytes(raw)


free_block_that_follows_itself.patch = free_for_ever
free_block_that_follows_itself.oldest = True


def own_child(key_size):
    def change(raw, at):
        struct.pack_into("<Q", raw, at + 24 + key_size, at)

    return change


def own_sibling(raw, at):
    struct.pack_into("<QQ", raw, at + 8, at, at)


def links_again_and_again(file, outside):
    """9000 links in a group of 900 names."""
    names(file, outside)
    for number in range(900):
        file[f"more{number}"] = file["setup2"]


def many_attributes(file, outside):
    for at in ("streams", "streams/loop", "streams/loop/test_iq", "setup", "parameters"):
        for number in range(6_000):
            file[at].attrs[f"n{number}"] = number


def kind(at, dtype, rows=10):
    def attack(file, outside):
        file.create_dataset(place(file, at), (rows,), dtype)

    return attack


def attribute(name, value, at="/"):
    def attack(file, outside):
        if name in file[at].attrs:
            del file[at].attrs[name]
        file[at].attrs[name] = value(file) if callable(value) else value

    return attack


def unknown_filter(file, outside):
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk((100,))
    plist.set_filter(h5py.h5z.FILTER_SHUFFLE, 0, ())
    plist.set_filter(32001 if h5py.h5z.filter_avail(32001) else h5py.h5z.FILTER_LZF, h5py.h5z.FLAG_OPTIONAL, ())
    space = h5py.h5s.create_simple((100,))
    h5py.h5d.create(file.id, place(file, "streams/loop/test_iq").encode(), h5py.h5t.NATIVE_DOUBLE, space, plist)


def million_rows_of_text(file, outside):
    file.create_dataset(place(file, "events/message"), (3 * 10**7,), "S512", chunks=(16,), maxshape=(None,))


def wide(file, outside):
    file.create_dataset(place(file, "streams/loop/test_iq"), (2**20, 2**20), "f8", chunks=(64, 64))


def text_of_width(width, rows=10):
    def attack(file, outside):
        file.create_dataset(place(file, "steps/name"), (rows,), f"S{width}")

    return attack


def spoiled_texts(at):
    """A column of texts whose packed references are no data."""

    def attack(file, outside):
        made = file.create_dataset(place(file, at), data=["a", "b"], dtype=layout.TEXT, chunks=(2,), compression="gzip")
        file.flush()
        made.id.write_direct_chunk((0,), b"no packed data")

    return attack


def texts_in_header(at, count, size):
    """A column of texts that stand in the object's header, in a file that has a long one."""

    def attack(file, outside):
        file.create_dataset("bench/more", data="x" * size, dtype=layout.TEXT)
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_layout(h5py.h5d.COMPACT)
        space = h5py.h5s.create_simple((count,))
        h5py.h5d.create(file.id, place(file, at).encode(), h5py.h5t.py_create(layout.TEXT, logical=True), space, plist)

    return attack


def user_block(file, outside):
    """HDF5 looks for its first byte at 0, 512, 1024 and so on."""


user_block.patch = lambda path: path.write_bytes(bytes(512) + path.read_bytes())


def small_addresses(file, outside):
    """Heaps of such files look otherwise, and are not looked through."""


def of_small_addresses(path):
    plist = h5py.h5p.create(h5py.h5p.FILE_CREATE)
    plist.set_sizes(4, 4)
    h5py.h5f.create(os.fsencode(path), h5py.h5f.ACC_TRUNC, plist).close()


small_addresses.patch = of_small_addresses


def crowded_heap(file, outside):
    file.create_dataset("bench/more", data=np.array(["x"] * 600_000, layout.TEXT), dtype=layout.TEXT)


def external(name, inside):
    return lambda outside: h5py.ExternalLink(str(outside / name), inside)


ATTACKS = {
    **{
        f"external link at {at}": linked(at, external("secret.h5", inside))
        for at, inside in (
            ("streams", "/streams"),
            ("streams/loop", "/streams/loop"),
            ("streams/loop/time", "/time"),
            ("streams/loop/test_iq", "/streams/loop/test_iq"),
            ("steps", "/streams"),
            ("notes", "/streams"),
            ("setup", "/streams"),
            ("parameters", "/streams"),
            ("seal", "/streams"),
            ("bench/source", "/text"),
            ("elsewhere", "/text"),
        )
    },
    "external link to a FIFO": linked("streams/loop", external("fifo", "/")),
    "external link to a FIFO in parameters": linked("parameters", external("fifo", "/")),
    "soft link to itself": linked("streams/loop/test_iq", lambda _: h5py.SoftLink("/streams/loop/test_iq")),
    "soft link to the root": linked("streams/loop/test_iq", lambda _: h5py.SoftLink("/")),
    "virtual time": virtual("streams/loop/time", "secret.h5"),
    "virtual column of steps": virtual("steps/start", "secret.h5"),
    "virtual channel of a FIFO": virtual("streams/loop/test_iq", "fifo"),
    "virtual channel of itself": virtual("streams/loop/test_iq", "."),
    "external storage of time": stored_outside("streams/loop/time", "secret.raw"),
    "external storage of a note": stored_outside("notes/text", "secret.raw"),
    "external storage in a FIFO": stored_outside("streams/loop/test_iq", "fifo"),
    "1e8 rows without storage": announced("streams/loop/test_iq", 10**8, **CHUNKED),
    "1e8 stamps without storage": announced("streams/loop/time", 10**8, **CHUNKED),
    "1e8 packed rows without storage": announced("streams/loop/time", 10**8, **PACKED),
    "1e8 contiguous rows without storage": announced("streams/loop/test_iq", 10**8),
    "1e12 rows": announced("streams/loop/test_iq", 10**12, **CHUNKED),
    "1e12 stamps": announced("streams/loop/time", 10**12, **CHUNKED),
    "1e18 rows": announced("streams/loop/time", 10**18, **CHUNKED),
    "3e7 texts of 512 bytes": million_rows_of_text,
    "2^40 values in two dimensions": wide,
    "a fixed text of 1 GiB": text_of_width(1 << 30),
    "1e6 fixed texts of 60 kB": text_of_width(60_000, 10**6),
    "a packed chunk of 1 GiB": one_packed_chunk(1 << 27),
    "a packed chunk of 1 GiB of stamps": one_packed_chunk(1 << 27, "streams/loop/time"),
    "a packed chunk of 65 MiB": one_packed_chunk(65 << 17),
    "a chunk packed twice": one_packed_chunk(1 << 19, filters=2),
    "a chunk that unpacks to more than it is": more_than_its_chunk("streams/loop/test_iq"),
    "stamps that unpack to more than they are": more_than_its_chunk("streams/loop/time"),
    "1 GiB of packed chunks": many_packed(1 << 27),
    "1 GiB of packed stamps": many_packed(1 << 27, "streams/loop/time"),
    "1 GiB in chunks of 32 MiB": many_packed(1 << 27, chunk=1 << 22),
    "1e5 texts of 1 MB that are one": texts_again_and_again("steps/name", 100_000, 1_000_000),
    "1000 texts of 10 MB that are one": texts_again_and_again("events/message", 1000, 10_000_000),
    "an attribute of 2000 texts of 1 MB that are one": attribute_again_and_again(
        2000, 1_000_000, layout.TEXT, lambda size: "x" * size
    ),
    "an attribute of 60 arrays of 16 MB that are one": attribute_again_and_again(
        60, 16_000_000, h5py.vlen_dtype("u1"), lambda size: np.ones(size, "u1")
    ),
    "such an attribute of the root": attribute_again_and_again(
        60, 16_000_000, h5py.vlen_dtype("u1"), lambda size: np.ones(size, "u1"), "/"
    ),
    "an attribute of 2000 arrays in one another": nested_arrays_of_an_attribute,
    "a dataset of 2000 arrays in one another": nested_arrays,
    "an attribute of 60 MB of text": long_text_attribute(60_000_000),
    "a channel's attribute of 60 MB of text": long_text_attribute(60_000_000, "streams/loop/test_iq"),
    "a huge attribute": attribute("huge", np.zeros(10**7)),
    "6,000 attributes on each": many_attributes,
    "a group that holds itself": holds_itself,
    "ten names for each group": ladder,
    "5000 groups in one another": deep,
    "30,000 groups": crowd,
    "30,000 links": names,
    "chunks of a node that is its own child": index_without_end(1, 1, own_child(24)),
    "chunks of a node that is its own sibling": index_without_end(1, 0, own_sibling),
    "members of a node that is its own child": index_without_end(0, 1, own_child(8)),
    "members of a node that is its own sibling": index_without_end(0, 0, own_sibling),
    "a free block that follows itself": free_block_that_follows_itself,
    "30,000 links in 900 groups": links_again_and_again,
    "9000 objects of one name of 60 kB": long_name_of_every_link(lambda file: file["setup"]),
    "9000 links of one name of 60 kB": long_name_of_every_link(lambda file: h5py.SoftLink("/setup")),
    "references": kind("streams/loop/test_iq", h5py.ref_dtype),
    "region references": kind("streams/loop/test_iq", h5py.regionref_dtype),
    "values of any length": kind("streams/loop/test_iq", h5py.vlen_dtype("f8")),
    "texts in packed chunks that are spoiled": spoiled_texts("steps/name"),
    "texts in a header that are one": texts_in_header("events/message", 3000, 1_000_000),
    "a user block before the file": user_block,
    "addresses of four bytes": small_addresses,
    "a heap of a million texts": crowded_heap,
    "3e5 steps": announced("steps/start", 300_000),
    "compound with texts": kind("steps/name", np.dtype([("a", layout.TEXT), ("b", layout.TEXT)])),
    "an unknown filter": unknown_filter,
}


HARMLESS = {"nothing": lambda file, outside: None}


def attack(title, base, path, outside, sealed=False, unfinished=False):
    """Write the run file `path`: the one at `base` under an attack, as of other makers or with its seal."""
    act = (ATTACKS | HARMLESS)[title]
    libver = "earliest" if getattr(act, "oldest", False) else layout.HDF5_FORMAT
    with h5py.File(base) as source, h5py.File(path, "w", libver=libver) as file:
        for name in source.attrs:
            file.attrs[name] = source.attrs[name]
        for name in source:
            source.copy(name, file)
        if not sealed:
            unseal(file)
            for _, dataset in list(layout.datasets(file)):
                del dataset.attrs["sha256"]
        act(file, outside)
        if unfinished:
            file.attrs["status"] = RECORDING
    if patch := getattr(act, "patch", None):
        patch(path)
    return path
