"""A finished file gets its name in one step, or the file of before stays."""

import errno
import os

import pytest

from leactl.errors import InputError
from leactl.runfile.publish import NotWritten, new_file, replacement


def refusing(monkeypatch, refused):
    """Have the file system refuse to force to the disk what `refused` says, by path."""
    fsync = os.fsync

    def forced(descriptor):
        if refused(os.readlink(f"/proc/self/fd/{descriptor}")):
            raise OSError(errno.EINVAL, "Invalid argument")
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", forced)


@pytest.mark.parametrize("publish", [new_file, replacement])
def test_a_folder_that_cannot_be_forced_to_the_disk_is_no_failure(tmp_path, monkeypatch, publish):
    refusing(monkeypatch, lambda path: path == str(tmp_path))
    with publish(tmp_path / "run.txt") as path:
        path.write_text("whole")
    assert [(entry.name, entry.read_text()) for entry in tmp_path.iterdir()] == [("run.txt", "whole")]


def test_a_file_that_cannot_be_forced_to_the_disk_leaves_the_one_of_before(tmp_path, monkeypatch):
    target = tmp_path / "run.txt"
    target.write_text("before")
    refusing(monkeypatch, lambda path: path.endswith(".tmp"))
    with pytest.raises(NotWritten, match=r"run\.txt: cannot be written: \[Errno 22\]"), replacement(target) as path:
        path.write_text("after")
    assert [(entry.name, entry.read_text()) for entry in tmp_path.iterdir()] == [("run.txt", "before")]


def test_no_file_is_overwritten_by_a_new_one(tmp_path):
    target = tmp_path / "run.txt"
    with pytest.raises(InputError, match="exists already"), new_file(target) as path:
        path.write_text("new")
        target.write_text("somebody else's")
    assert [(entry.name, entry.read_text()) for entry in tmp_path.iterdir()] == [("run.txt", "somebody else's")]
