"""The stop key in a real pseudo terminal, which is given back as it was on every end that a process can see."""

import fcntl
import json
import os
import pty
import select
import signal
import subprocess
import termios
import time

import pytest

from tests.cli.terminal import COMMAND
from tests.runner.conftest import SPIN

HINT = b"space or q stops the run"
PATIENCE_S = 60


class Terminal:
    """A terminal with a person at it, and a command in its foreground."""

    def __init__(self, *arguments, preparation=""):
        self.hands, self.place = pty.openpty()
        self.before = termios.tcgetattr(self.place)
        code = f"{preparation}\n{COMMAND[2]}"

        def own():
            os.setsid()
            fcntl.ioctl(self.place, termios.TIOCSCTTY, 0)

        self.process = subprocess.Popen(
            [*COMMAND[:2], code, *arguments],
            stdin=self.place,
            stdout=subprocess.PIPE,
            stderr=self.place,
            env=os.environ | {"TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"},
            preexec_fn=own,
        )
        self.shown = b""
        self.end = time.monotonic() + PATIENCE_S

    def read_until(self, over):
        """Take what is shown until that is so."""
        while not over():
            assert time.monotonic() < self.end, self.shown
            if select.select([self.hands], [], [], 0.05)[0]:
                self.shown += os.read(self.hands, 65536)

    def press(self, keys):
        """Type once the display says which key stops."""
        self.read_until(lambda: HINT in self.shown or self.process.poll() is not None)
        assert not termios.tcgetattr(self.place)[3] & termios.ICANON
        os.write(self.hands, keys)

    def wait(self):
        self.read_until(lambda: self.process.poll() is not None)
        return self.process.stdout.read()

    def hang_up(self):
        """Take the terminal away, as a closed window or a lost connection does."""
        os.close(self.place)
        os.close(self.hands)
        self.hands = self.place = None

    def close(self):
        self.process.kill()
        self.process.communicate()
        for descriptor in (self.hands, self.place):
            if descriptor is not None:
                os.close(descriptor)


@pytest.fixture
def terminal(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "spin.yaml").write_text(SPIN)
    opened = []

    def run(*arguments, hold_s="600", preparation=""):
        command = ("run", "spin.yaml", "--realtime", "--json", "--set", f"hold_s={hold_s}")
        opened.append(Terminal(*command, *arguments, preparation=preparation))
        return opened[-1]

    yield run
    for each in opened:
        each.close()


@pytest.mark.parametrize(
    ("keys", "cause"),
    [
        (b" ", "stopped by the operator: key space"),
        (b"\x03", "stopped by SIGINT"),
        pytest.param(b"q", "stopped by the operator: key q", marks=pytest.mark.long),
        pytest.param(b"\x1c", "stopped by SIGQUIT", marks=pytest.mark.long),
    ],
)
def test_a_key_stops_the_run_and_the_terminal_is_given_back(terminal, keys, cause):
    at = terminal()
    at.press(keys)
    answer = json.loads(at.wait())
    assert (at.process.returncode, answer["status"], answer["reason"]) == (4, "stopped", cause)
    assert all(device["confirmed"] for device in answer["safe"].values())
    assert f"leactl: {cause}".encode() in at.shown
    assert termios.tcgetattr(at.place) == at.before


@pytest.mark.parametrize("number", [pytest.param(signal.SIGTERM, marks=pytest.mark.long), signal.SIGHUP])
def test_a_signal_gives_the_terminal_back(terminal, number):
    if signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip(f"{number.name} is ignored here, as under nohup, and so in every process that is started")
    at = terminal()
    at.press(b"")
    at.process.send_signal(number)
    assert json.loads(at.wait())["reason"] == f"stopped by {number.name}"
    assert termios.tcgetattr(at.place) == at.before


def test_a_terminal_that_hangs_up_stops_the_run(terminal):
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        pytest.skip("SIGHUP is ignored here, as under nohup, and so in every process that is started")
    at = terminal()
    at.press(b"")
    at.hang_up()
    answer = json.loads(at.process.communicate(timeout=PATIENCE_S)[0])
    assert (at.process.returncode, answer["status"], answer["reason"]) == (4, "stopped", "stopped by SIGHUP")


def test_a_trip_gives_the_terminal_back(terminal):
    at = terminal("--set", "current_A=2.5")
    assert json.loads(at.wait())["status"] == "tripped"
    assert termios.tcgetattr(at.place) == at.before


CRASH = """
from leactl.runner import latch
def crash(*_): raise RuntimeError("no such luck")
latch.of = crash
"""


def test_a_crash_gives_the_terminal_back(terminal):
    at = terminal(preparation=CRASH)
    at.wait()
    assert at.process.returncode == 1
    assert b"no such luck" in at.shown
    assert termios.tcgetattr(at.place) == at.before


# a child of the session's leader, in a group of its own, is what a shell's `&` makes
BEHIND = """
import os, sys
child = os.fork()
if child:
    sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
os.setpgid(0, 0)
"""


def test_in_the_background_no_key_is_taken_and_the_terminal_is_left_alone(terminal):
    at = terminal(hold_s="0.2", preparation=BEHIND)
    os.write(at.hands, b"q")
    assert json.loads(at.wait())["status"] == "complete"
    assert HINT not in at.shown
    assert at.process.returncode == 0
