"""The process beside a run: it leaves no trace of an orderly end, survives the terminal, and is itself missed."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from leactl.driver.contract import Confirmation
from leactl.emulation.clock import EmulatedClock
from leactl.errors import DeviceError, LeactlError, SafetyTrip
from leactl.runner import watchdog
from leactl.safety.supervisor import Supervisor
from tests.cli.terminal import COMMAND, leactl
from tests.latches import trip_of
from tests.runner.conftest import SPIN


def children():
    me = os.getpid()
    return {int(word) for word in Path(f"/proc/{me}/task/{me}/children").read_text().split()}


@pytest.fixture
def its_watchdog(monkeypatch):
    """The processes that runs of this test have started."""
    started = []
    begin = watchdog.Watchdog.begin

    def noted(self, period):
        started.append(self._process.pid)
        begin(self, period)

    monkeypatch.setattr(watchdog.Watchdog, "begin", noted)
    return started


def test_an_orderly_end_leaves_no_process_no_latch_and_no_word(spin, its_watchdog, capfd):
    before = children()
    outcome, _bench = spin(realtime=True)
    assert outcome.error is None
    assert len(its_watchdog) == 1
    assert children() == before
    assert trip_of("emulated") is None
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("then", ["goes on", "fails"])
def test_a_loop_that_stood_still_unseen_by_its_watchdog_trips_by_itself(spin, monkeypatch, then):
    begin, check, now_of, calls, stood_s = watchdog.Watchdog.begin, Supervisor.check, EmulatedClock.now, [], [0.0]

    def overlooked(self, period):
        begin(self, period)
        self.allowed_s = 0.1  # for the loop alone

    def standing(self, now):
        calls.append(now)
        if len(calls) == 20:
            stood_s[0] = 0.3
            if then == "fails":
                raise DeviceError("drive_test: nothing has come for a while")
        check(self, now)

    monkeypatch.setattr(watchdog.Watchdog, "begin", overlooked)
    monkeypatch.setattr(Supervisor, "check", standing)
    monkeypatch.setattr(EmulatedClock, "now", lambda self: now_of(self) + stood_s[0])
    outcome, _bench = spin(realtime=True)
    assert isinstance(outcome.error, SafetyTrip)
    assert f"the control loop of process {os.getpid()} stood still for" in str(outcome.error)
    assert str(outcome.error) == trip_of("emulated").cause


@pytest.mark.parametrize("realtime", [True, False])
def test_an_end_that_is_not_confirmed_latches_and_is_the_watchdog_s_to_end(spin, monkeypatch, capfd, realtime):
    """An end in order, but for a drive that does not answer."""
    whole = Supervisor.make_safe

    def unanswered(self):
        return whole(self) | {"drive_test": Confirmation(False, "no answer")}

    monkeypatch.setattr(Supervisor, "make_safe", unanswered)
    outcome, _bench = spin(realtime=realtime)
    said = "NOT CONFIRMED SAFE, switch off the supply: drive_test: no answer"
    assert isinstance(outcome.error, DeviceError)
    assert outcome.reason == said
    assert trip_of("emulated").cause == said
    assert trip_of("emulated").run == str(outcome.path)
    told = f"leactl watchdog: the run ended, and: {said}\n"
    assert capfd.readouterr().err == (told if realtime else "")
    with pytest.raises(SafetyTrip, match="no answer"):
        spin(realtime=realtime)


def test_an_emulated_bench_on_its_own_time_needs_none(spin, its_watchdog):
    spin()
    assert its_watchdog == []


def test_a_watchdog_that_dies_trips_the_run(spin, its_watchdog):
    outcome, _bench = spin(realtime=True, at=[(0.3, lambda _bench: os.kill(its_watchdog[0], signal.SIGKILL))])
    assert isinstance(outcome.error, SafetyTrip)
    assert outcome.reason == "the run's watchdog has ended, status -9"
    assert trip_of("emulated").cause == outcome.reason


def test_the_terminal_s_signals_are_not_the_watchdog_s(spin, its_watchdog):
    def signalled(_bench):
        for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
            os.kill(its_watchdog[0], number)
        assert os.getsid(its_watchdog[0]) != os.getsid(0)

    outcome, _bench = spin(realtime=True, at=[(0.3, signalled)])
    assert outcome.error is None


def test_a_watchdog_that_does_not_start_refuses_the_run(spin, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(LeactlError, match="the run's watchdog did not start: it ended without a word"):
        spin(realtime=True)


@pytest.fixture
def stuck(tmp_path, monkeypatch):
    """The environment of a run whose loop stands still in its 40th cycle."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spin.yaml").write_text(SPIN)
    (tmp_path / "sitecustomize.py").write_text(
        "import time\nfrom leactl.safety import supervisor\n"
        "check, calls = supervisor.Supervisor.check, []\n"
        "def stuck(self, now):\n"
        "    calls.append(now)\n"
        "    while len(calls) == 40:\n"
        "        time.sleep(1)\n"
        "    check(self, now)\n"
        "supervisor.Supervisor.check = stuck\n"
    )
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    return os.environ | {"PYTHONPATH": path}


def test_a_stderr_that_nobody_reads_holds_up_no_end(stuck):
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with suppress(BlockingIOError):
        while True:
            os.write(writer, bytes(4096))
    os.set_blocking(writer, True)
    run = subprocess.Popen([*COMMAND, "run", "spin.yaml", "--realtime"], env=stuck, stderr=writer)
    os.close(writer)
    with os.fdopen(reader, "rb") as rest:
        try:
            assert run.wait(60) == -signal.SIGKILL
        finally:
            run.kill()
            rest.read()  # until the watchdog has ended as well
    assert "stood still for" in trip_of("emulated").cause


def test_a_loop_that_stands_still_is_ended_and_the_bench_latched(stuck, tmp_path):
    done = leactl("run", "spin.yaml", "--realtime", **stuck)
    assert done.returncode == -signal.SIGKILL
    told, killed = done.stderr.splitlines()
    assert told.startswith("leactl watchdog: the control loop of process ")
    assert told.endswith(" s; 1 s are allowed")
    assert killed.endswith(" does not end by itself and is killed")
    assert trip_of("emulated").cause == told.removeprefix("leactl watchdog: ")
    refused = leactl("run", "spin.yaml", "--json", **os.environ)
    assert refused.returncode == 3
    assert "stood still for" in refused.stderr
    (file,) = (tmp_path / "runs").iterdir()
    checked = leactl("runs", "verify", str(file), "--json", **os.environ)
    assert "incomplete recording" in json.dumps(json.loads(checked.stdout))
