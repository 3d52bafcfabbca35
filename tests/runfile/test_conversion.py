"""Run files in the format of HDF5 1.10: written so, and made so where a newer library wrote them otherwise."""

import shutil
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest

from leactl.errors import InputError
from leactl.runfile import layout
from leactl.runfile.verify.conversion import convert
from leactl.runfile.verify.integrity import annotate, checksums, recover, verify
from leactl.runfile.write.writer import RunWriter

from .specimen import STREAMS, as_left_by_a_kill, info

H5DUMP = shutil.which("h5dump")
NEWEST_LAYOUT_OF_1_10 = 4  # of the data layout message, IV.A.2.i of the HDF5 file format 3.0
LAYOUT_MESSAGE = 8


def layouts(path: Path) -> set[int]:
    """Versions of the data layout messages of a file, read from the bytes of its object headers (version 2)."""
    versions = set()
    raw = path.read_bytes()
    with h5py.File(path, "r", swmr=True) as file:
        addresses = [h5py.h5o.get_info(item.id).addr for _, item in layout.datasets(file)]
    for address in addresses:
        assert raw[address : address + 4] == b"OHDR"
        flags = raw[address + 5]
        head = address + 6 + (16 if flags & 0x20 else 0) + (4 if flags & 0x10 else 0)
        width = 1 << (flags & 3)
        end = head + width + int.from_bytes(raw[head : head + width], "little")
        versions |= set(layout_versions(raw, head + width, end, 6 if flags & 4 else 4))
    return versions


def layout_versions(raw: bytes, start: int, end: int, prefix: int):
    """Yield the version in each data layout message of a chunk of an object header; follow continuations."""
    while start + prefix <= end:
        kind, size = raw[start], int.from_bytes(raw[start + 1 : start + 3], "little")
        body = start + prefix
        if kind == LAYOUT_MESSAGE:
            yield raw[body]
        if kind == 0x10:
            offset, length = (int.from_bytes(raw[k : k + 8], "little") for k in (body, body + 8))
            yield from layout_versions(raw, offset + 4, offset + length - 4, prefix)
        start = body + size


@pytest.fixture
def newest(complete: Path, tmp_path: Path) -> Path:
    """The run as the newest format of this library has it."""
    path = tmp_path / "newest.h5"
    with h5py.File(complete) as old, h5py.File(path, "w", libver="latest") as new:
        new.attrs.update(old.attrs)
        for place, item in layout.datasets(old):
            kinds = (
                {"chunks": item.chunks, "maxshape": item.maxshape, "compression": item.compression}
                if item.chunks
                else {}
            )
            dataset = new.create_dataset(place, data=item[()], dtype=item.dtype, **kinds)
            dataset.attrs.update(layout.attributes(item))
        for name in ("setup", "parameters", "instruments"):
            if name in old:
                new.create_group(name).attrs.update(old[name].attrs)
        for stream in new["streams"].values():
            stream["time"].make_scale("time")
            for name in stream:
                if name != "time":
                    stream[name].dims[0].attach_scale(stream["time"])
    return path


def test_a_run_is_in_the_format_of_hdf5_1_10_while_it_is_written_and_after(tmp_path: Path):
    with RunWriter(tmp_path, info(), STREAMS) as writer:
        writer.append_row("loop", 0.0, [1.0, 2.0, 3.0])
        writer.flush()
        assert max(layouts(writer.path)) <= NEWEST_LAYOUT_OF_1_10
    assert layouts(writer.path)
    assert max(layouts(writer.path)) <= NEWEST_LAYOUT_OF_1_10
    annotate(writer.path, "a note")
    assert max(layouts(writer.path)) <= NEWEST_LAYOUT_OF_1_10


def test_a_recovered_run_is_in_the_format_of_hdf5_1_10(tmp_path: Path):
    writer = RunWriter(tmp_path, info(), STREAMS)
    writer.append_row("loop", 0.0, [1.0, 2.0, 3.0])
    writer.flush()
    assert max(layouts(recover(as_left_by_a_kill(writer)))) <= NEWEST_LAYOUT_OF_1_10
    writer.close("stopped", "by hand")


@pytest.mark.skipif(H5DUMP is None, reason="no h5dump on this machine")
def test_h5dump_reads_a_run(complete: Path):
    done = subprocess.run([H5DUMP, "-d", "/streams/loop/theta", complete], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "499.5" in done.stdout


def test_a_run_of_the_newest_format_becomes_old_with_every_value_and_attribute(newest: Path):
    annotate(newest, "before")
    with h5py.File(newest) as file:
        before = {place: dict(item.attrs) for place, item in layout.datasets(file)}
        root = dict(file.attrs)
    values = checksums(newest)
    if h5py.version.hdf5_version_tuple >= (2, 0, 0):
        assert max(layouts(newest)) > NEWEST_LAYOUT_OF_1_10
    convert(newest)
    assert verify(newest) == []
    assert max(layouts(newest)) <= NEWEST_LAYOUT_OF_1_10
    assert checksums(newest) == values
    with h5py.File(newest) as file:
        assert dict(file.attrs) == root
        for place, attributes in before.items():
            own = layout.attributes(file[place])
            assert {name: own.get(name) for name in own} == {
                name: layout.to_python(value) for name, value in attributes.items() if name in own
            }
        assert file["streams/loop/iq"].dims[0][0] == file["streams/loop/time"]


def test_converting_twice_changes_nothing(complete: Path):
    values = checksums(complete)
    convert(complete)
    convert(complete)
    assert checksums(complete) == values
    assert verify(complete) == []


def test_a_run_that_is_being_written_is_not_converted(tmp_path: Path):
    writer = RunWriter(tmp_path, info(), STREAMS)
    writer.append_row("loop", 0.0, [1.0, 2.0, 3.0])
    writer.flush()
    with pytest.raises(InputError, match="still being written"):
        convert(writer.path)
    writer.close("stopped", "by hand")
    assert np.isfinite(h5py.File(writer.path)["streams/loop/iq"][0])
