"""The live view shows a run and never holds it: a stopped terminal, a broken view, a text that looks like markup."""

import json
import os
import pty
import signal
import subprocess
import termios
import time
from contextlib import contextmanager

import pytest

from leactl.report.run_progress import draw
from leactl.runfile.read.reader import Run
from leactl.runner.progress import Progress
from tests.cli.terminal import COMMAND
from tests.runner.conftest import SPIN


def test_a_stopped_terminal_does_not_keep_a_run_from_its_end(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spin.yaml").write_text(SPIN)
    screen, terminal = pty.openpty()
    command = [*COMMAND, "run", "spin.yaml", "--set", "hold_s=60", "--realtime", "--json"]
    environment = os.environ | {"TERM": "xterm-256color"}
    run = subprocess.Popen(command, stdin=terminal, stdout=subprocess.PIPE, stderr=terminal, env=environment)
    try:
        shown = b""
        while b"test velocity" not in shown:
            shown += os.read(screen, 65536)
        termios.tcflow(terminal, termios.TCOOFF)  # Ctrl-S
        time.sleep(0.6)  # the view is within a frame
        run.send_signal(signal.SIGINT)
        os.set_blocking(run.stdout.fileno(), False)
        answer, end = b"", time.monotonic() + 10
        while not answer.endswith(b"\n") and time.monotonic() < end:
            answer += run.stdout.read() or b""
            time.sleep(0.05)
        assert answer, "no end within 10 s"
        assert json.loads(answer)["status"] == "stopped"
        assert all(device["confirmed"] for device in json.loads(answer)["safe"].values())
        termios.tcflow(terminal, termios.TCOON)
        os.set_blocking(screen, False)
        while run.poll() is None and time.monotonic() < end:
            try:
                shown += os.read(screen, 65536)
            except BlockingIOError:
                time.sleep(0.05)
        assert run.wait(5) == 4
        with Run.open(tmp_path / json.loads(answer)["run"]) as recorded:
            assert [event.level for event in recorded.events if event.source == "view"] == ["warning"]
    finally:
        run.kill()
        run.communicate()
        os.close(screen)
        os.close(terminal)


@contextmanager
def broken_at_once(_progress):
    raise OSError("no terminal")
    yield


@contextmanager
def broken_at_the_end(_progress):
    yield
    raise OSError("no terminal")


@pytest.mark.parametrize("view", [broken_at_once, broken_at_the_end])
def test_a_broken_view_is_noted_and_the_run_is_complete(spin, view):
    outcome, _bench = spin(watch=view)
    assert (outcome.status, outcome.error) == ("complete", None)
    assert outcome.notes == ["the view has failed: OSError: no terminal"]
    with Run.open(outcome.path) as run:
        assert [event.message for event in run.events if event.source == "view"] == outcome.notes


def test_devices_are_safe_before_the_view_is_left(spin):
    found, benches = [], []

    @contextmanager
    def view(_progress):
        try:
            yield
        finally:
            found.extend(benches[0].far_ends[name].state for name in ("drive_test", "drive_load"))

    outcome, _bench = spin(watch=view, at=[(0.0, benches.append)], sets=("current_A=2.5", "hold_s=2"))
    assert outcome.status == "tripped"
    assert found == ["disabled", "disabled"]


def test_what_looks_like_markup_is_shown_as_it_is():
    progress = Progress("a run", 1.0, {}, step="lock [/home] and [red]", prompt="[/home]")
    shown = [line.plain for line in draw(progress, 80, 24)]
    assert shown[1].startswith("lock [/home] and [red]")
    assert shown[-1].startswith("[/home]")
