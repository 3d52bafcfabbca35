"""The index of every file that h5py writes is a tree, in whatever format, and in the oldest one it is looked at."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from leactl.errors import InputError
from leactl.runfile.hdf5 import btrees
from leactl.runfile.hdf5.opening import open_foreign

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


@pytest.mark.parametrize("fill", FILLS)
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
