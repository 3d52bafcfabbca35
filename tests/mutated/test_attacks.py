"""Run files of a stranger who means ill: refused by every command, soon, in little memory, nothing outside opened."""

import shutil
import struct
import zlib

import h5py
import numpy as np
import pytest

from leactl.errors import InputError
from leactl.runfile.hdf5 import tree
from leactl.runfile.hdf5.opening import open_run_file
from leactl.runfile.importing.sources.formats.mat import mat_tree
from tests.analysis.short_runs import short_run
from tests.mutated import attacks
from tests.mutated.child import outcome
from tests.mutated.test_mutated_files import NOMINAL, command
from tests.mutated.test_mutated_runs import COMMANDS
from tests.runfile.specimen import unseal

MORE = {
    "runs attach": lambda path: ("runs", "attach", path, path.parent.parent / "nominal.yaml", "--device", "camera"),
    "runs export --format mat": lambda path: ("runs", "export", path, "--format", "mat", "--out", path.parent / "out"),
    "runs import": lambda path: ("runs", "import", path, "--map", path.parent.parent / "map.yaml"),
    "thermal fit": lambda path: ("thermal", "fit", path),
    "gap compare": lambda path: ("gap", "compare", path, path),
    "gap plan": lambda path: ("gap", "plan", path, "--model", path.parent.parent / "nominal.yaml"),
    "gap simulate": lambda path: ("gap", "simulate", path.parent.parent / "nominal.yaml", path),
}
EVERY = COMMANDS | MORE
LISTS = ("runs list", "runs list --json")  # which name the file with its reason, and go on
WORST = (
    "external link to a FIFO",
    "external storage in a FIFO",
    "virtual time",
    "1e12 stamps",
    "stamps that unpack to more than they are",
)
MAPPING = """
format: mat
mechanical: free
streams:
  loop:
    time: {column: streams.loop.time}
    channels:
      iq: {column: streams.loop.test_iq, quantity: q_axis_current}
"""


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    return short_run("friction", tmp_path_factory.mktemp("base"))


@pytest.fixture(scope="module")
def outside(tmp_path_factory):
    return attacks.make_outside(tmp_path_factory.mktemp("stranger") / "outside")


@pytest.fixture
def path(tmp_path):
    (tmp_path / "nominal.yaml").write_text(NOMINAL)
    (tmp_path / "map.yaml").write_text(MAPPING)
    (tmp_path / "run").mkdir()
    return tmp_path / "run" / "run.h5"


def opened(path):
    def work():
        try:
            open_run_file(path)
        except InputError as fault:
            print(fault)
            return 2
        return 0

    return work


def beyond(ended, least):
    return ended._replace(megabytes=ended.megabytes - least).fault


@pytest.mark.parametrize("title", attacks.ATTACKS)
def test_no_attack_passes_the_door(base, outside, path, title):
    attacks.attack(title, base, path, outside, unfinished=True)
    least = outcome(lambda: 0).megabytes
    ended = outcome(opened(path))
    assert (ended.status, beyond(ended, least)) == (2, ""), ended.said
    assert f"{path}: " in ended.said
    assert str(int(attacks.SECRET)) not in ended.said


@pytest.mark.parametrize("title", WORST)
def test_no_command_follows_an_attack(base, outside, path, title):
    attacks.attack(title, base, path, outside, unfinished=True)
    least = outcome(lambda: 0).megabytes
    for name, arguments in EVERY.items():
        ended = outcome(command(*arguments(path)))
        assert (ended.status, beyond(ended, least)) == (0 if name in LISTS else 2, ""), (name, ended.said)
        assert str(int(attacks.SECRET)) not in ended.said, name


@pytest.mark.parametrize("title", attacks.HARMLESS)
@pytest.mark.parametrize("name", ["runs list", "runs show", "runs verify", "runs export"])
def test_what_does_no_harm_is_read(base, outside, path, title, name):
    attacks.attack(title, base, path, outside)
    ended = outcome(command(*EVERY[name](path)))
    assert (ended.status, ended.fault) == (0, ""), ended.said


def mat(path, fill):
    """A MAT file of version 7.3."""
    with h5py.File(path, "w", userblock_size=512) as file:
        fill(file)
    return path


def cell(file, name, references):
    dataset = file.create_dataset(name, (len(references),), h5py.ref_dtype)
    dataset.attrs["MATLAB_class"] = np.bytes_("cell")
    dataset[:] = references
    return dataset


def holds_itself(file):
    file["a"] = np.zeros(1)
    dataset = cell(file, "c", [file["a"].ref] * 2)
    dataset[:] = [dataset.ref] * 2


def refers_again(file):
    """A thousand references to an array of 1 MB in each of a thousand cells that one refers to."""
    file["#refs#/a"] = np.zeros(1 << 17)
    inner = cell(file, "#refs#/b", [file["#refs#/a"].ref] * 1000)
    cell(file, "c", [inner.ref] * 1000)


def swelling(file, outside):
    file["a"] = np.zeros(1)
    attacks.more_than_its_chunk("a")(file, outside)


MAT = {
    "link to a FIFO": (lambda outside: lambda file: file.__setitem__("a", h5py.ExternalLink(outside / "fifo", "/")), 2),
    "stored elsewhere": (lambda outside: lambda file: attacks.stored_outside("a", "secret.raw")(file, outside), 2),
    "virtual": (lambda outside: lambda file: attacks.virtual("a", "fifo")(file, outside), 2),
    "1e12 rows": (lambda outside: lambda file: file.create_dataset("a", (10**12,), "f8", **attacks.CHUNKED), 2),
    "unpacks": (lambda outside: lambda file: swelling(file, outside), 2),
    "a cell of itself": (lambda outside: holds_itself, 2),
    "one array in a million cells": (lambda outside: refers_again, 0),
}


@pytest.mark.parametrize("title", MAT)
def test_a_mat_file_leads_nowhere_else(tmp_path, outside, title):
    fill, status = MAT[title]
    path = mat(tmp_path / "a.mat", fill(outside))
    least = outcome(lambda: 0).megabytes

    def work():
        try:
            mat_tree(path)
        except InputError as fault:
            print(fault)
            return 2
        return 0

    ended = outcome(work)
    assert (ended.status, beyond(ended, least)) == (status, ""), ended.said
    assert str(int(attacks.SECRET)) not in ended.said


@pytest.mark.parametrize(
    ("mark", "order", "first"),
    [
        (b"\0\1IM", "<", b""),
        (b"\0\1IM", "<", struct.pack("<LL", 14, 8) + bytes(8)),
        (b"\1\0MI", ">", struct.pack(">LL", 14, 8) + bytes(8)),
        (b"\1\0XX", ">", b""),
    ],
    ids=["alone", "behind one not packed", "in the other order", "with a mark that says no order"],
)
def test_a_mat_file_of_version_5_unpacks_no_further_than_it_may(tmp_path, monkeypatch, mark, order, first):
    path = tmp_path / "a.mat"
    packed = zlib.compress(struct.pack(f"{order}LL", 14, 1 << 22) + bytes(1 << 22))
    bomb = struct.pack(f"{order}LL", 15, len(packed)) + packed
    path.write_bytes(b"MATLAB 5.0".ljust(124) + mark + first + bomb)
    monkeypatch.setattr("leactl.runfile.importing.sources.formats.mat.MOST_UNPACKED", (8, 1 << 20))
    with pytest.raises(InputError, match=f"{path}: unpacks to more than"):
        mat_tree(path)


def test_chunks_that_give_what_they_announce_pass(base, path, monkeypatch):
    monkeypatch.setattr(tree, "MOST_UNCHECKED_BYTES", 0)
    shutil.copy(base, path)
    file, _ = open_run_file(path)
    file.close()


EVIL = "a\x1b[31m\x07\x9b2J\u202eb"


@pytest.fixture(scope="module")
def ill_named(base, tmp_path_factory):
    """A run whose path and every text hold what a terminal would obey."""
    folder = tmp_path_factory.mktemp("evil")
    (folder / "nominal.yaml").write_text(NOMINAL)
    (folder / "map.yaml").write_text(MAPPING)
    path = folder / EVIL / f"{EVIL}.h5"
    path.parent.mkdir()
    shutil.copy(base, path)
    with h5py.File(path, "r+") as file:
        unseal(file)
        for name in ("actuator", "condition", "operator", "bench", "status_reason"):
            file.attrs[name] = EVIL
        file["setup"].attrs[EVIL] = file["parameters"].attrs[EVIL] = EVIL
        file.move("streams/torque_sensor/torque", f"streams/torque_sensor/{EVIL}")
        file.move("streams/torque_sensor", f"streams/{EVIL}")
        for place in ("steps/name", "events/message", "events/source", "events/level"):
            del file[place].attrs["sha256"]
            file[place][:] = [EVIL] * len(file[place])
    return path


@pytest.mark.parametrize("name", EVERY)
def test_no_command_passes_a_control_character_on(ill_named, name):
    ended = outcome(command(*EVERY[name](ill_named)))
    assert ended.status in (0, 2), ended.said
    assert ended.said
    assert not set("\x1b\x07\x9b\u202e") & set(ended.said)
