"""Files that hold their reader for ever, or are larger than any of their kind, are refused before they are read."""

import os
from pathlib import Path

import pytest

from leactl.errors import InputError
from leactl.model.cycle import MOST_FILE_BYTES, MOST_ROWS, read_cycle
from leactl.regular_files import open_regular
from leactl.tables import text_table
from leactl.tables.text_table import MOST_BYTES as MOST_OF_TABLE
from tests.driver.camera import camera

READERS = {"cycle": (read_cycle, MOST_FILE_BYTES), "camera": (lambda path: camera().read_files([path]), MOST_OF_TABLE)}


@pytest.fixture(params=["fifo", "device"])
def endless(tmp_path, request):
    path = tmp_path / "endless.csv"
    if request.param == "fifo":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    return path


def test_a_file_of_another_kind_is_not_opened(endless):
    with pytest.raises(OSError, match="a regular file was expected"):
        open_regular(endless)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (Path.mkdir, "Is a directory"),
        (os.mkfifo, "a regular file was expected"),
        (lambda path: path.write_bytes(b"xx"), "1 are read"),
    ],
)
def test_what_is_refused_leaves_no_descriptor_open(tmp_path, make, reason):
    make(tmp_path / "it")
    before = os.listdir("/proc/self/fd")
    with pytest.raises(OSError, match=reason) as caught:
        open_regular(tmp_path / "it", most_bytes=1)
    assert caught.value.filename == str(tmp_path / "it")
    assert len(os.listdir("/proc/self/fd")) == len(before)


@pytest.mark.parametrize("kind", READERS)
def test_a_table_without_end_is_refused(endless, kind):
    with pytest.raises(InputError, match=rf"{endless}: a regular file was expected; this is none"):
        READERS[kind][0](endless)


@pytest.mark.parametrize("kind", READERS)
def test_a_table_that_is_too_large_is_not_read(tmp_path, kind):
    reader, most = READERS[kind]
    path = tmp_path / "large.csv"
    path.touch()
    os.truncate(path, most + 1)
    with pytest.raises(InputError, match=f"{most + 1} bytes; at most {most} are read") as caught:
        reader(path)
    assert len(caught.value.faults) == 1


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_text_is_as_long_as_its_characters_are_many(tmp_path, monkeypatch, encoding):
    monkeypatch.setattr(text_table, "MOST_CHARACTERS", 1000)
    path = tmp_path / "table.csv"
    path.write_text("x" * 999, encoding)
    assert text_table.read_text(path, None)[0] == "x" * 999
    path.write_text("x" * 1001, encoding)
    with pytest.raises(InputError, match=r"100[12] characters; at most 1000 are read; export it in parts"):
        text_table.read_text(path, None)


def test_rows_of_a_cycle_are_read_no_further_than_they_may_be(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_text("time_s,angle_rad,torque_Nm\n" + "0,0,1\n" * (MOST_ROWS + 1) + "no row at all" + "," * 9)
    with pytest.raises(InputError, match=f"more than {MOST_ROWS} rows"):
        read_cycle(path)
