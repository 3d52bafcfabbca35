"""The index of every file that h5py writes is a tree, in whatever format, and in the oldest one it is looked at."""

import io
import itertools
import struct
from pathlib import Path

import h5py
import numpy as np
import pytest

from leactl.errors import InputError
from leactl.runfile.hdf5 import btrees
from leactl.runfile.hdf5.opening import open_foreign
from leactl.runfile.hdf5.swmr import checksum

OLDEST = [{"libver": ("earliest", "v108")}, {"libver": "earliest", "userblock_size": 1024}]
NEWER = [{"libver": "v108"}, {"libver": "v110"}, {"libver": "latest"}]


def many_chunks(file):
    file.create_dataset("a", data=np.arange(20_000.0), chunks=(2,), maxshape=(None,))


def packed(file):
    values = np.arange(30_000.0).reshape(100, 100, 3)
    file.create_dataset("a", data=values, chunks=(7, 3, 2), compression="gzip", shuffle=True, fletcher32=True)


def extended(file):
    made = file.create_dataset("a", (0, 3), "f4", chunks=(5, 3), maxshape=(None, None))
    for rows in range(50, 5001, 50):
        made.resize((rows, 3))
        made[rows - 50 :] = rows
    made.resize((700, 9))
    made[:] = 1
    made.resize((3000, 2))


def written_in_disorder(file):
    made = file.create_dataset("a", (5000,), "i2", chunks=(1,))
    for row in np.random.default_rng(1).permutation(5000):
        made[row] = row


def members_that_came_and_went(file):
    for number in range(3000):
        file.create_group(f"g{number}")
    for number in range(0, 3000, 2):
        del file[f"g{number}"]
    for number in range(1000):
        file[f"h/{number}"] = file[f"g{2 * number + 1}"]
    for _ in range(4):
        many_chunks(file)
        del file["a"]


def many_attributes(file):
    for number in range(3000):
        file.attrs[f"n{number}"] = number
    many_chunks(file)


def ordered(file):
    group = file.create_group("g", track_order=True)
    for number in range(500):
        group.create_dataset(f"{number}", data=np.arange(6.0), chunks=(2,))


FILLS = (
    many_chunks,
    packed,
    extended,
    written_in_disorder,
    members_that_came_and_went,
    many_attributes,
    ordered,
)


@pytest.mark.parametrize("fill", FILLS)
@pytest.mark.parametrize("form", [*OLDEST, *NEWER], ids=str)
def test_every_file_of_h5py_is_read(tmp_path: Path, fill, form):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", **form) as file:
        fill(file)
    open_foreign(path).close()


def test_a_file_that_grows_in_swmr_mode_is_read(tmp_path: Path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver="latest") as file:
        made = file.create_dataset("a", (0,), "f8", chunks=(4,), maxshape=(None,))
        file.swmr_mode = True
        for rows in range(40, 40_001, 40):
            made.resize((rows,))
            made[-40:] = rows
            made.flush()
    open_foreign(path).close()


@pytest.mark.parametrize(
    "fill",
    [pytest.param(fill, marks=[pytest.mark.long] if fill is members_that_came_and_went else []) for fill in FILLS],
)
@pytest.mark.parametrize("form", OLDEST, ids=str)
def test_every_node_of_the_oldest_format_is_looked_at(tmp_path: Path, fill, form, monkeypatch):
    """Whichever node becomes its own neighbour, and so its neighbours' no more, the file is refused."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", **form) as file:
        fill(file)
    met = set()
    look = btrees.BTrees._node

    def looked(self, address, kind):
        met.add(self._base + address)
        return look(self, address, kind)

    monkeypatch.setattr(btrees.BTrees, "_node", looked)
    open_foreign(path).close()
    raw = path.read_bytes()
    assert all(raw.startswith(b"TREE", at) for at in met)
    assert len(met) > 5
    for at in sorted(met)[::20]:
        path.write_bytes(raw[: at + 8] + (at - form.get("userblock_size", 0)).to_bytes(8, "little") + raw[at + 16 :])
        with pytest.raises(InputError, match="is no tree"):
            open_foreign(path)


def attributes_of_a_group(file):
    group = file.create_group("g")
    for number in range(3000):
        group.attrs[f"n{number}"] = number


def members(file):
    for number in range(3000):
        file.create_group(f"g{number}")


def chunks_in_two_directions(file):
    values = np.arange(90_000.0).reshape(300, 300)
    file.create_dataset("a", data=values, chunks=(2, 2), maxshape=(None, None), compression="gzip")


def chunks_in_one_direction(file):
    file.create_dataset("a", data=np.arange(90_000.0), chunks=(2000,), maxshape=(None,), compression="gzip")


def chunks_of_a_fixed_array(file):
    file.create_dataset("a", data=np.arange(90_000.0), chunks=(2000,), compression="gzip")


def large_attributes(file):
    group = file.create_group("g")
    for number in range(400):
        group.attrs[f"n{number}"] = np.bytes_("x" * 50_000)


def with_one_large_attribute_told(raw):
    """The index of what lies outside a heap's blocks says one record and has more."""
    begin = raw.index(b"BTHD\0\1")
    return renewed(raw, begin, begin + 34, begin + 26, struct.pack("<Q", 1))


def renewed(raw, begin, end, at, packed):
    """The file with other bytes in a structure, and its checksum at `end` made right again."""
    raw[at : at + len(packed)] = packed
    raw[end : end + 4] = checksum(bytes(raw[begin:end])).to_bytes(4, "little")
    return bytes(raw)


def with_every_child_the_first(raw):
    """Each pointer of the topmost tree's root leads to the same child."""
    begin = raw.rindex(b"BTHD")
    size, record_size, depth = struct.unpack_from("<IHH", raw, begin + 6)
    root, records = struct.unpack_from("<QH", raw, begin + 16)
    assert depth >= 1
    first = root + 6 + records * record_size
    (pointer_size,) = (
        width for width in range(9, 14) if is_checksum_at(raw, root, first + (records + 1) * width, size)
    )
    return renewed(
        raw, root, first + (records + 1) * pointer_size, first, bytes(raw[first : first + pointer_size]) * (records + 1)
    )


def is_checksum_at(raw, begin, end, most):
    return end - begin < most and int.from_bytes(raw[end : end + 4], "little") == checksum(bytes(raw[begin:end]))


def with_number(signature, at, length, number, form="<Q"):
    def change(raw):
        begin = raw.rindex(signature)
        return renewed(raw, begin, begin + length, begin + at, struct.pack(form, number))

    return change


@pytest.mark.parametrize(
    ("fill", "change", "words"),
    [
        (attributes_of_a_group, with_every_child_the_first, "/g: damaged: the index of its members, .* is no tree"),
        (members, with_every_child_the_first, "/: damaged: the index of its members, .* is no tree"),
        (chunks_in_two_directions, with_every_child_the_first, "/a: damaged: the index of its members, .* is no tree"),
        (attributes_of_a_group, with_number(b"BTHD", 26, 34, 5), "/g: damaged: its index has 3000 records and says 5"),
        (attributes_of_a_group, with_number(b"BTHD", 26, 34, 1 << 40), "/g: 1099511627776 records in its index"),
        (members, with_number(b"BTHD", 10, 34, 20, "<H"), "/: damaged: .* has other records"),
        (members, with_number(b"BTHD", 12, 34, 60, "<H"), "/: an index of 60 levels"),
        (members, with_number(b"FRHP", 10, 142, 1 << 20, "<I"), "/: a heap for objects of 1048576 bytes"),
        (members, with_number(b"FRHP", 7, 142, 9, "<H"), "/: its links or attributes are packed"),
        (chunks_in_one_direction, with_number(b"EAHD", 44, 68, 1 << 40), "/a: 1099511627776 elements in the index"),
        (chunks_of_a_fixed_array, with_number(b"FAHD", 8, 24, 1 << 40), "/a: 1099511627776 elements in the index"),
        (large_attributes, with_one_large_attribute_told, "/g: damaged: its index has 400 records and says 1"),
        (large_attributes, bytes, "/g: more than 16777216 bytes of large links or attributes"),
    ],
)
def test_an_index_of_newer_formats_that_keeps_hdf5_busy_is_refused(tmp_path: Path, fill, change, words):
    """Its checksums are right; HDF5 overflows its table of the attributes or walks the index for ever."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver="latest") as file:
        fill(file)
    path.write_bytes(change(bytearray(path.read_bytes())))
    with pytest.raises(InputError, match=words):
        open_foreign(path)


def test_a_block_of_empty_messages_is_read_no_further_than_the_limit(monkeypatch):
    monkeypatch.setattr(btrees, "MOST_MESSAGES", 100)
    header = b"OHDR\x02\x02" + struct.pack("<I", 1 << 16)  # flags 2: the size of the block takes four bytes
    messages = btrees.BTrees(io.BytesIO(header + bytes(1 << 16)), 0)._messages(0)
    assert sum(1 for _ in itertools.islice(messages, 100)) == 100
    with pytest.raises(InputError, match="headers of more than 100 entries"):
        next(messages)


def test_a_spoiled_index_of_newer_formats_is_for_hdf5_to_tell(tmp_path: Path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver="latest") as file:
        members(file)
    raw = path.read_bytes()
    at = raw.rindex(b"BTHD")
    path.write_bytes(raw[: at + 12] + b"\xff" + raw[at + 13 :])
    with pytest.raises(InputError, match="checksum"):
        open_foreign(path)


@pytest.mark.parametrize("track_order", [True, False])
def test_large_attributes_are_read(tmp_path: Path, track_order):
    """Each counts once, in whichever orders they are listed."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver="latest") as file:
        for group in (file.create_group(f"g{number}", track_order=track_order) for number in range(10)):
            for number in range(15):
                group.attrs[f"n{number}"] = np.bytes_("x" * 62_000)
    open_foreign(path).close()
