"""Latch and winding memory are open before the first move: their last writing takes no descriptor and no room."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from leactl.model.motor import load_motor
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runfile.write import writer
from leactl.runner import flushing, latch, state_folder, watchdog_process
from leactl.runner.boot_time import ClockReadings
from leactl.runner.latch import LATCH_BYTES, OpenLatch
from leactl.runner.thermal_memory import Keeper, Memory
from tests.cli.terminal import COMMAND
from tests.kills.trial import watchdog_of
from tests.latches import latch_of, trip_of
from tests.runner.conftest import SPIN


@contextmanager
def no_descriptor_left():
    """Every descriptor that this process may have is taken."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    lowest = os.open("/dev/null", os.O_RDONLY)
    os.close(lowest)
    resource.setrlimit(resource.RLIMIT_NOFILE, (lowest, before[1]))
    try:
        with pytest.raises(OSError, match="Too many open files"):
            os.open("/dev/null", os.O_RDONLY)
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.fixture
def ready():
    held = OpenLatch(latch_of("emulated"))
    yield held
    held.close()


def test_a_latch_that_is_ready_holds_nothing_and_has_its_room(ready):
    assert trip_of("emulated") is None
    path = Path(latch_of("emulated").paths[0])
    assert path.stat().st_size == LATCH_BYTES
    assert path.stat().st_blocks * 512 >= LATCH_BYTES


def test_a_latch_that_was_not_set_leaves_no_file():
    OpenLatch(latch_of("emulated")).close()
    assert not Path(latch_of("emulated").paths[0]).exists()


def test_a_latch_is_set_without_a_descriptor_and_stays(tmp_path):
    held = OpenLatch(latch_of("emulated"))
    with no_descriptor_left():
        held.set("too fast", tmp_path)
    held.close()
    assert (trip_of("emulated").cause, trip_of("emulated").run) == ("too fast", str(tmp_path))


@pytest.mark.parametrize("how", ["removed", "moved", "folder removed", "replaced", "linked"])
def test_a_latch_whose_file_went_is_set_where_it_is_looked_for(ready, how, tmp_path):
    path = Path(latch_of("emulated").paths[0])
    path.rename(tmp_path / "elsewhere")
    if how == "folder removed":
        (path.parent / "runs").rmdir() if (path.parent / "runs").exists() else None
        path.parent.rmdir()
    elif how == "replaced":
        path.write_bytes(latch.RELEASED)
    elif how == "linked":
        path.symlink_to(tmp_path / "elsewhere")
        with pytest.raises(Exception, match="could not be latched"):
            ready.set("too fast", tmp_path)
        assert trip_of("emulated") is not None  # the link itself holds
        return
    ready.set("too fast", tmp_path)
    assert trip_of("emulated").cause == "too fast"


def test_a_latch_is_set_without_memory_for_its_words(ready, monkeypatch, tmp_path):
    def exhausted(*_words):
        raise MemoryError

    monkeypatch.setattr(latch, "_content", exhausted)
    ready.set("too fast", tmp_path)
    assert trip_of("emulated").cause == "unknown, for want of memory"


def test_a_latch_that_cannot_be_made_ready_moves_nothing(spin, monkeypatch):
    monkeypatch.setenv("LEACTL_STATE", "/proc/nowhere")
    with pytest.raises(Exception, match="no trip could be latched"):
        spin(realtime=True)


def test_the_last_writing_of_a_winding_needs_no_descriptor(tmp_path):
    memory = Memory("rig.test", load_motor("lea")[0], 130.0, 25.0, state_folder.StateFolder(tmp_path, shared=False))
    now = ClockReadings(1.7e9, "this boot", 5000.0)
    nodes = {"test": np.full(3, 60.0)}
    keeper = Keeper({"test": memory}, lambda: nodes, lambda: now)
    keeper.start()
    nodes["test"] = np.full(3, 70.0)
    with no_descriptor_left():
        keeper.stop()
    kept = json.loads(memory.path.read_text())
    assert (kept["running"], kept["nodes_degC"]) == (False, [70.0] * 3)


@pytest.mark.parametrize("how", ["removed", "replaced"])
def test_a_winding_s_memory_that_went_is_made_anew(tmp_path, how):
    memory = Memory("rig.test", load_motor("lea")[0], 130.0, 25.0, state_folder.StateFolder(tmp_path, shared=False))
    now = ClockReadings(1.7e9, "this boot", 5000.0)
    memory.keep(np.full(3, 60.0), now, running=True)
    memory.path.unlink()
    if how == "replaced":
        memory.path.write_text("{}")
    memory.keep(np.full(3, 70.0), now, running=False)
    assert memory.recall(now).nodes[0] == pytest.approx(70.0)


def about(process):
    """Whether a process is killed last for want of memory, and whether what it has there is locked."""
    score = Path(f"/proc/{process}/oom_score_adj").read_text().strip()
    status = Path(f"/proc/{process}/status").read_text()
    return score, "VmLck:\t       0 kB" in status


@pytest.fixture
def permitted():
    """A process that has done what the kernel permits here."""
    text = (
        "from leactl.runner.watchdog_process import protect_process; protect_process(); print(1, flush=True); input()"
    )
    process = subprocess.Popen([sys.executable, "-c", text], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "1\n"
    yield process
    process.communicate("\n")


def test_a_watchdog_without_a_descriptor_latches_a_run_that_is_killed(tmp_path, monkeypatch, permitted):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spin.yaml").write_text(SPIN.replace("hold_s: 0.6", "hold_s: 60"))
    run = subprocess.Popen([*COMMAND, "run", "spin.yaml", "--realtime"], stderr=subprocess.PIPE, text=True)
    try:
        while not list((tmp_path / "state" / "runs").glob("*.run")):  # which is made once the watchdog is ready
            assert run.poll() is None
        dog = watchdog_of(run.pid)
        resource.prlimit(dog, resource.RLIMIT_NOFILE, (0, 0))
        result = about(dog)
    finally:
        run.send_signal(signal.SIGKILL)
        told = run.stderr.read()  # until the watchdog has ended as well
        run.wait()
        run.stderr.close()
    assert "ended without making the bench safe" in told
    assert trip_of("emulated").cause in told
    assert result == about(permitted.pid)


def test_what_is_in_memory_is_locked_there_and_the_kernel_asked(monkeypatch, tmp_path):
    """By what is asked for, since not every machine permits it."""
    asked, score = [], tmp_path / "score"

    class Library:
        def mlockall(self, flags):
            asked.append(flags)
            return -1  # refused, which is nothing to a watchdog

    monkeypatch.setattr(watchdog_process.ctypes, "CDLL", lambda name: Library())
    monkeypatch.setattr(watchdog_process, "OOM_SCORE", score)
    watchdog_process.protect_process()
    assert (asked, score.read_text()) == ([1], "-1000")
    monkeypatch.setattr(watchdog_process, "OOM_SCORE", tmp_path / "none" / "score")
    watchdog_process.protect_process()


# -- the folder of the run's file ------------------------------------------------------------------------------------


def folder_removed(runs):
    shutil.rmtree(runs)


def folder_moved(runs):
    runs.rename(runs.with_name("old"))


def file_exchanged(runs):
    [file] = runs.glob("*.h5")
    file.unlink()
    file.write_text("another")


@pytest.mark.parametrize("vanish", [folder_removed, folder_moved, file_exchanged])
@pytest.mark.parametrize("at", [0.2, 0.75])  # s, of which the second is in the run's last flush
def test_rows_of_a_run_whose_folder_vanishes_go_elsewhere_and_that_is_told(spin, tmp_path, monkeypatch, vanish, at):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(flushing, "FLUSH_INTERVAL_S", 0.0)
    outcome, _bench = spin(at=[(at, lambda _bench: vanish(tmp_path / "runs"))])
    assert (outcome.status, outcome.error) == ("complete", None)
    elsewhere = tmp_path if vanish is file_exchanged else tmp_path / "runs"
    assert outcome.path.parent == elsewhere
    assert verify(outcome.path) == []
    with Run.open(outcome.path) as run:
        assert run.status == "complete"
        time = run.channel("q_axis_current", role="test").time
    assert time[0] < 0.05
    assert time[-1] > 0.75
    assert np.diff(time) == pytest.approx(0.01)
    [told] = [note for note in outcome.notes if "was removed or moved while it was written" in note]
    assert told.endswith(f"every row of the run is in {outcome.path}")


def test_a_folder_that_can_be_nowhere_ends_the_run(spin, tmp_path, monkeypatch):
    monkeypatch.setattr(flushing, "FLUSH_INTERVAL_S", 0.0)

    def nowhere(_rows, _name, _folders):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writer, "copy_to_first", nowhere)
    outcome, _bench = spin(at=[(0.3, lambda _bench: shutil.rmtree(tmp_path / "runs"))])
    assert outcome.status == "failed"
    assert "recording failed" in outcome.reason
    assert all(confirmation.safe for confirmation in outcome.safe.values())


@pytest.mark.parametrize(
    ("number", "helps"),
    [
        (28, "free space on the disk"),
        (24, "raise the limit of open files (ulimit -n)"),
        (13, "let this user write there, or choose --out"),
        (2, "make the folder again, or choose --out"),
        (12, "end other programs, for memory is short"),
        (5, "free space on the disk"),
    ],
)
def test_each_cause_has_its_own_advice_and_all_have_one_status(spin, tmp_path, monkeypatch, number, helps):
    monkeypatch.setattr(flushing, "FLUSH_INTERVAL_S", 0.0)

    def refused(*_reserved):
        raise OSError(number, os.strerror(number))

    outcome, _bench = spin(at=[(0.3, lambda _bench: monkeypatch.setattr(writer, "reserve", refused))])
    assert (outcome.status, outcome.error.exit_status) == ("failed", 2)
    assert outcome.reason.endswith(f"{os.strerror(number)}; {helps}, then run: leactl runs recover")
    assert all(confirmation.safe for confirmation in outcome.safe.values())
