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


@pytest.mark.parametrize("publish", [new_file, replacement])
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "browser"), "was not written: .*'browser'"),
        (ConnectionResetError(errno.ECONNRESET, "Connection reset by peer"), "was not written: .*reset by peer"),
        (OSError(errno.ENOSPC, "No space left on device"), "cannot be written: .*No space left"),
    ],
)
def test_a_target_is_blamed_for_its_own_faults_alone(tmp_path, publish, fault, words):
    with pytest.raises(NotWritten, match=rf"run\.txt: {words}") as caught, publish(tmp_path / "run.txt") as path:
        path.write_text("half")
        raise fault
    assert len(caught.value.faults) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_the_targets_fault(tmp_path):
    target = tmp_path / "none" / "run.txt"
    with pytest.raises(NotWritten, match=r"run\.txt: cannot be written: "), replacement(target) as path:
        path.write_text("half")
