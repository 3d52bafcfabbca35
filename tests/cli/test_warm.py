"""A command that a warm process forks is the one that an interpreter of its own would run."""

import os
import subprocess

import pytest

from tests.cli import warm
from tests.cli.terminal import COMMAND


def of_its_own(words):
    done = subprocess.run([*COMMAND, *words], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


def forked(words):
    done = warm.run(words)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ["bench", "show", "emulated"],
        ["bench", "show", "absent.yaml", "--json"],
        ["gap", "effects", "gremlins"],
        ["protocol", "show", "friction"],
        ["runs", "list", "."],
        ["no-such-command"],
        [],
    ],
    ids=" ".join,
)
def test_status_output_and_errors_are_the_same(words):
    assert forked(words) == of_its_own(words)


def test_folder_environment_and_an_unforeseen_error_are_those_of_the_moment(tmp_path, monkeypatch):
    (tmp_path / "mine.yaml").write_text("bench: [")
    monkeypatch.chdir(tmp_path)
    status, _, errors = forked(["bench", "show", "mine.yaml"])
    assert (status, errors.startswith("leactl: mine.yaml")) == (2, True)
    monkeypatch.setenv("LEACTL_TRACE", "1")
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "mine.yaml" / "state"))
    words = ["bench", "show", "emulated"]
    assert forked(words) == of_its_own(words)


def test_one_command_leaves_nothing_behind_for_the_next():
    first = forked(["runs", "list", "."])
    descriptors = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        assert forked(["runs", "list", "."]) == first
    assert len(os.listdir("/proc/self/fd")) == descriptors


@pytest.mark.parametrize("name", ["PYTHONIOENCODING", "LC_ALL"])
def test_what_an_interpreter_reads_at_its_start_takes_one_of_its_own(monkeypatch, name):
    assert warm.run(["--version"]) is not None
    monkeypatch.setenv(name, "C")
    assert warm.run(["--version"]) is None


def test_an_environment_that_is_asked_for_often_has_a_warm_process_too(monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "ascii:backslashreplace")
    words = ["motor", "show", "lea"]
    first = [warm.run(words) for _ in range(warm.WORTH_ITS_IMPORTS - 1)]
    assert set(first) == {None}
    assert forked(words) == of_its_own(words)
    monkeypatch.setenv("PYTHONPATH", "elsewhere")
    assert [warm.run(words) for _ in range(warm.WORTH_ITS_IMPORTS)] == [None] * warm.WORTH_ITS_IMPORTS


def test_input_is_read_to_its_end():
    words = ["protocol", "check", "-"]
    for text in ("name: [", "", "name: x\n"):
        own = subprocess.run([*COMMAND, *words], input=text, capture_output=True, text=True, check=False)
        done = warm.run(words, input=text)
        assert (done.returncode, done.stdout, done.stderr) == (own.returncode, own.stdout, own.stderr)
