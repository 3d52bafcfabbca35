"""Labels, notes and names of others reach no terminal as commands to it."""

import io
import os
import shutil

import h5py
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.cli.printable import Printable, printable
from tests.cli.terminal import leactl
from tests.runner.conftest import SPIN

EVIL = "a\x1b[31m\x07\x9b2J\u202eb"


@given(st.text())
def test_nothing_that_a_terminal_obeys_passes_and_all_else_does(text):
    shown = printable(text)
    assert not any(c in shown for c in "\x1b\x07\x08\x9b\x7f\u202e")
    assert printable(shown) == shown
    buffer = io.BytesIO()
    stream = Printable(buffer, "utf-8", "surrogatepass", "\n")
    stream.write(text)
    stream.flush()
    assert buffer.getvalue().decode("utf-8", "surrogatepass") == shown
    if text.isprintable() and not set(text) & set("\u200e\u200f"):
        assert shown == text


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A run file whose every text that a person gave holds control characters."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    done = leactl(
        "run", "friction", "--set", "trials=1", "--set", "hold_s=2", "--set", "settle_s=1", "--actuator", "a1"
    )
    assert done.returncode == 0, done.stderr
    [path] = (tmp_path / "runs").glob("*.h5")
    foreign = tmp_path / "foreign.h5"
    shutil.copy(path, foreign)
    with h5py.File(foreign, "r+") as file:
        for name in ("actuator", "condition", "operator", "bench"):
            file.attrs[name] = EVIL
        if "checksums" in file.attrs:
            del file.attrs["checksums"]
    return foreign


@pytest.mark.parametrize(
    "command",
    [
        ["analyze", "{}"],
        ["stats", "{}"],
        ["runs", "show", "{}"],
        ["runs", "list", "."],
        ["runs", "verify", "{}"],
        ["report", "{}", "--out", "page.html"],
        ["protocol", "check", "no\x1b[31m.yaml"],
        ["bench", "check", "\x1b]0;x\x07"],
    ],
)
def test_no_command_passes_a_control_character_on(run, command):
    done = leactl(*[word.format(run) for word in command])
    assert not set("\x1b\x07\x9b\u202e") & set(done.stdout + done.stderr)


@pytest.mark.parametrize(
    ("label", "words"),
    [("a" * 250, "--actuator: 250 characters; at most 100 were expected"), (EVIL, "printable text was expected")],
)
@pytest.mark.parametrize("command", [["run", "spin.yaml"], ["thermal", "state", "--bench", "testbed"]])
def test_a_label_that_names_no_file_is_status_2_in_one_line(tmp_path, monkeypatch, command, label, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spin.yaml").write_text(SPIN)
    done = leactl(*command, "--actuator", label, **os.environ)
    assert (done.returncode, done.stdout) == (2, "")
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_machine_without_the_bus_says_so_once(testbed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = leactl("bench", "jog", testbed, "--current", "0.1")
    if "Address family" not in done.stderr and "no SocketCAN" not in done.stderr and "no such CAN" not in done.stderr:
        assert "cold" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.count("SocketCAN") + done.stderr.count("no such CAN interface") <= 1
    assert "Errno" not in done.stderr
