"""The live view as a screen shows it, and the lines that stand for it where there is no screen."""

import fcntl
import io
import itertools
import math
import os
import pty
import select
import struct
import subprocess
import termios
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console

from leactl.quantities import ChannelSpec
from leactl.report import run_progress
from leactl.report.run_progress import draw, live_view
from leactl.runner.operators import STOP_HINT
from leactl.runner.progress import Progress
from tests.cli.terminal import COMMAND
from tests.runner.conftest import SPIN

CHANNELS = tuple(
    ChannelSpec(f"{role}_{quantity}", quantity, role, "drive")
    for role in ("test", "load")
    for quantity in (
        "q_axis_current_reference",
        "q_axis_current",
        "angle",
        "velocity",
        "drive_enabled",
    )
)


def halfway(**kept):
    progress = Progress("friction on emulated", 100.0, {"loop": CHANNELS}, hint=STOP_HINT, **kept)
    progress.values, progress.done_s, progress.step = [float(n) for n in range(10)], 50.0, "hold"
    return progress


@given(
    width=st.integers(1, 250),
    height=st.integers(1, 60),
    step=st.text(max_size=80),
    encoding=st.sampled_from(["utf-8", "ascii"]),
)
def test_a_frame_never_exceeds_its_terminal(width, height, step, encoding):
    progress = halfway()
    progress.step = step
    lines = draw(progress, width + 1, height, encoding)
    assert len(lines) <= height
    assert all(cell_len(line.plain) <= width for line in lines)
    "".join(line.plain for line in lines).encode(encoding)


@pytest.mark.parametrize(("width", "height"), [(80, 24), (200, 50), (120, 30), (121, 30)])
def test_every_value_is_shown_whole(width, height):
    shown = "\n".join(line.plain for line in draw(halfway(), width, height))
    for number, channel in enumerate(CHANNELS):
        if channel.unit != "1":
            assert f"{number:.3f} {channel.unit}" in shown
    assert "test current ref" in shown
    assert shown.endswith(STOP_HINT)


@pytest.mark.parametrize("height", range(1, 12))
def test_how_to_stop_is_the_last_to_go_and_the_step_the_last_but_one(height):
    shown = [line.plain for line in draw(halfway(), 40, height)]
    assert shown[-1] == STOP_HINT
    assert height == 1 or any(line.startswith("hold") for line in shown)


def test_values_without_room_are_counted():
    shown = [line.plain for line in draw(halfway(), 40, 10)]
    assert shown[-2] == "5 more values in a higher window"
    assert sum(" A" in line or " rad" in line or "enabled" in line for line in shown) == 5


def test_progress_shows_without_colours():
    bar = draw(halfway(), 41, 10, "ascii")[2].plain
    assert bar == "#" * 20 + "-" * 20


def test_without_a_terminal_lines_come_less_and_less_often():
    progress, passed, pauses = halfway(), itertools.count(), []

    def wait(pause):
        pauses.append(pause)
        return next(passed) >= 100

    console = Console(file=io.StringIO(), force_terminal=False)
    run_progress._write(progress, console, wait)
    lines = console.file.getvalue().splitlines()
    assert len(lines) == 100
    assert pauses[0] == 5.0
    assert pauses == sorted(pauses)
    assert pauses[-1] == 30.0
    for part in ("friction on emulated: hold", "50%", "0:50 of 1:40", "test current ref 0.000 A", STOP_HINT):
        assert part in lines[0]


def test_a_run_that_is_soon_over_writes_no_line():
    console = Console(file=io.StringIO(), force_terminal=False)
    with live_view(halfway(), console):
        pass
    assert console.file.getvalue() == ""


def test_a_value_that_is_missing_is_no_number():
    progress = halfway()
    progress.values = [math.nan] * 10
    shown = "\n".join(line.plain for line in draw(progress, 80, 24))
    assert "ref" not in shown  # nothing is commanded
    assert shown.count("nan A") == 2


def test_after_a_resize_and_while_a_question_stands_a_frame_begins_at_the_top(monkeypatch):
    # a terminal that folds long lines when it narrows moves the old frame to where nobody knows
    progress, console, frames = halfway(), Console(file=io.StringIO(), force_terminal=True), []
    sizes = iter([(80, 24), (80, 24), (40, 24), (40, 24), (40, 24)])
    monkeypatch.setattr(run_progress, "_size", lambda _console: next(sizes))

    def wait(_pause):
        frames.append(console.file.getvalue()[sum(map(len, frames)) :])
        progress.prompt = "open the door?" if len(frames) == 4 else ""
        return len(frames) > 4

    run_progress._paint(progress, console, wait)
    assert [run_progress.TO_THE_TOP in frame for frame in frames[1:]] == [False, True, False, True]


class Screen:
    """A run in a terminal of a size, and what that terminal shows."""

    def __init__(self, columns, lines, **environment):
        pyte = pytest.importorskip("pyte", reason="the terminal's screen is emulated by pyte")
        self.hands, self.terminal = pty.openpty()
        self.screen = pyte.Screen(columns, lines)
        self.stream = pyte.ByteStream(self.screen)
        self.resize(columns, lines)
        os.write(self.terminal, b"$ leactl run spin.yaml\r\n")
        self.run = subprocess.Popen(
            [*COMMAND, "run", "spin.yaml", "--realtime", "--set", "hold_s=600"],
            stdin=self.terminal,
            stdout=subprocess.DEVNULL,
            stderr=self.terminal,
            env={key: value for key, value in os.environ.items() if key not in ("COLUMNS", "LINES")}
            | {"TERM": "xterm-256color"}
            | environment,
        )

    def resize(self, columns, lines):
        fcntl.ioctl(self.terminal, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        self.screen.resize(lines, columns)

    def shown(self, over):
        """The lines on the screen once they are so."""
        end = time.monotonic() + 30
        while True:
            lines = [line.rstrip() for line in self.screen.display]
            if over(lines):
                return lines
            assert time.monotonic() < end, "\n".join(lines)
            if select.select([self.hands], [], [], 0.05)[0]:
                self.stream.feed(os.read(self.hands, 65536))

    def frame(self):
        """The lines of a frame with a known pace."""
        return self.shown(lambda lines: STOP_HINT in lines and any(" left" in line for line in lines))

    def close(self):
        self.run.kill()
        self.run.communicate()
        os.close(self.hands)
        os.close(self.terminal)


@pytest.fixture
def screen(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "spin.yaml").write_text(SPIN)
    opened = []

    def run(*size, **environment):
        opened.append(Screen(*size, **environment))
        return opened[-1]

    yield run
    for each in opened:
        each.close()


@pytest.mark.parametrize(
    "size", [(80, 24), *(pytest.param(size, marks=pytest.mark.long) for size in ((200, 50), (40, 10)))]
)
def test_a_terminal_shows_the_setpoint_and_how_to_stop(screen, size):
    at = screen(*size)
    lines = at.frame()
    assert lines[0] == "$ leactl run spin.yaml" or size[1] == 10
    assert sum("current ref" in line for line in lines) == 1
    assert sum(line.startswith("spin on emulated") for line in lines) == 1
    os.write(at.hands, b"q")
    after = at.shown(lambda lines: any("stopped by the operator" in line for line in lines))
    assert not any("current ref" in line for line in after)


def test_a_resized_terminal_keeps_no_part_of_an_older_frame(screen):
    at = screen(80, 24)
    at.frame()
    for size in ((50, 24), (120, 12), (40, 10), (100, 40)):
        at.resize(*size)
        at.shown(lambda lines, width=size[0]: max(map(len, lines)) == width - 1)
        lines = at.frame()
        assert sum(line.startswith("spin on emulated") for line in lines) == 1
        assert lines.count(STOP_HINT) == 1


def test_a_terminal_of_ascii_is_sent_ascii(screen):
    at = screen(80, 24, LC_ALL="C", NO_COLOR="1")
    lines = at.frame()
    assert all(line.isascii() for line in lines)
    assert any(line.startswith("---") or line.startswith("#") for line in lines)
