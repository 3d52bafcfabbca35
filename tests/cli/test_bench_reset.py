"""`leactl bench reset` beside runs: none has the bench meanwhile, and what cannot be written is said and holds."""

import json
import os
import resource
import subprocess
from contextlib import contextmanager
from pathlib import Path

import pytest

from leactl.bench import benchfile
from leactl.errors import InputError, LeactlError, SafetyTrip
from leactl.runner import bench_reset, latch, locks, runs_underway, state_folder
from tests.cli.terminal import COMMAND, leactl
from tests.latches import latch_of

NAME = f"testbed-{os.getpid()}"
CAUSE = "test current of 31.2 A passed the limit of 30 A"
LOST = "process 1 of the run heat ended without a word, and its watchdog too"


@pytest.fixture(autouse=True)
def own_state(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))


@pytest.fixture
def tripped(testbed, tmp_path):
    held = latch_of(str(testbed), in_process=False)
    held.set(CAUSE, tmp_path / "a.h5")
    return held


@contextmanager
def full_disk():
    """Let no write of this process succeed."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_leaves_the_cause_of_a_latch_whole(tripped, tmp_path):
    with full_disk(), pytest.raises(LeactlError, match="the trip could not be latched: File too large"):
        tripped.set("another one", tmp_path / "b.h5")
    assert tripped.trip().cause == CAUSE
    tripped.set("short", tmp_path / "b.h5")
    assert tripped.trip().cause == "short"


def lose_a_run():
    """Leave what a run on real buses leaves whose process and watchdog were killed; its file."""
    runs = state_folder.of_machine().runs
    path = runs / f"{NAME}.1.0.run"
    about = {"bench": NAME, "file": "testbed.yaml", "protocol": "heat", "process": 1, "real": True, "run": "r.h5"}
    path.write_bytes(b"--" + json.dumps(about).encode() + b"\n")
    return path


@pytest.mark.parametrize("word", [NAME, "testbed.yaml"], ids=["by name", "by file"])
def test_a_bench_that_a_run_drives_is_not_reset(tripped, holder, word):
    refused = leactl("bench", "reset", word, "--yes")
    assert (refused.returncode, refused.stdout) == (5, "")
    assert refused.stderr == (
        f"leactl: bench '{NAME}' cannot be reset: a run or another reset has it, process {holder.pid};"
        " wait for its end, or: leactl bench stop\n"
    )
    assert tripped.trip().cause == CAUSE
    holder.kill()
    holder.wait()
    assert leactl("bench", "reset", word, "--yes").stdout == f"{NAME}: released\n"


def test_a_bench_that_is_served_is_not_reset_under_its_run():
    served = benchfile.load("emulated")[0]
    with locks.alone(locks.name_of(served), "taken"):
        refused = leactl("bench", "reset", "emulated", "--yes")
    assert refused.returncode == 5
    assert f"a run or another reset has it, process {os.getpid()};" in refused.stderr


@pytest.fixture
def asked(tripped):
    """A reset that has told the cause and waits for its answer."""
    process = subprocess.Popen(
        [*COMMAND, "bench", "reset", NAME],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert CAUSE in process.stderr.readline()
    yield process
    process.kill()
    process.communicate()


def test_a_run_that_takes_the_bench_while_a_reset_asks_keeps_its_latch(asked, tripped, testbed):
    file, devices, _document = benchfile.load(str(testbed))
    with locks.held(file, devices):
        _out, said = asked.communicate("y\n", timeout=60)
    assert asked.returncode == 5
    assert "cannot be reset: a run or another reset has it" in said
    assert tripped.trip().cause == CAUSE


def test_a_trip_that_came_while_a_reset_asked_is_not_released_with_the_one_that_was_told(asked, tripped, tmp_path):
    tripped.set("test winding of 131 degC", tmp_path / "b.h5")
    _out, said = asked.communicate("y\n", timeout=60)
    assert asked.returncode == 3
    assert f"leactl: what holds bench '{NAME}' has changed meanwhile; nothing was released\n" in said
    assert tripped.trip().cause == "test winding of 131 degC"


@pytest.mark.parametrize("kind", ["a folder", "a link"])
def test_a_lost_run_whose_latch_cannot_be_written_holds_until_a_reset_that_says_so(testbed, kind):
    path = Path(latch_of(str(testbed), in_process=False).paths[0])
    file = lose_a_run()
    path.mkdir() if kind == "a folder" else path.symlink_to(path.parent / "nowhere")
    for _again in range(2):
        with pytest.raises(SafetyTrip) as refusal:
            latch.refuse_lost_runs(NAME)
        said = str(refusal.value)
        assert said.startswith(f"bench '{NAME}' is tripped: {LOST}; {path}: the trip could not be latched: ")
        assert said.endswith(f"; see: leactl bench reset {NAME}")
    unsure = leactl("bench", "reset", NAME, input="n\n")
    assert unsure.returncode == 4
    assert f"{LOST}; {path}: the trip could not be latched: " in unsure.stderr
    assert file.exists()
    assert leactl("bench", "reset", NAME, "--yes").stdout == f"{NAME}: released\n"
    assert not file.exists()
    latch.refuse_lost_runs(NAME)
    assert leactl("bench", "reset", str(testbed)).stdout == f"{NAME}: not tripped\n"


def in_a_folder_that_is_read_alone(monkeypatch, files_too):
    """As for a user who may not write there: the kernel refuses what root may do."""

    def refused(path, *_how, **_more):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "unlink", refused)
    if files_too:
        opened = os.open

        def read_alone(path, how, *mode):
            if str(path).endswith(".run") and how & os.O_RDWR:
                refused(path)
            return opened(path, how, *mode)

        monkeypatch.setattr(os, "open", read_alone)


def test_a_lost_run_in_a_folder_that_cannot_be_written_is_marked_and_told_once(testbed, monkeypatch):
    file = lose_a_run()
    in_a_folder_that_is_read_alone(monkeypatch, files_too=False)
    latch.refuse_lost_runs(NAME)
    assert file.exists()
    assert runs_underway.lost(NAME) == []


def test_a_lost_run_whose_file_can_be_neither_removed_nor_written_holds_and_is_named(testbed, monkeypatch):
    file = lose_a_run()
    in_a_folder_that_is_read_alone(monkeypatch, files_too=True)
    words = rf"{file}: can be neither removed nor written: .*; it holds the bench until its owner, or root, removes it"
    held = bench_reset.held_by(NAME, NAME)
    assert next(trip.cause for trip in held.trips) == LOST
    with pytest.raises(InputError, match=words):
        bench_reset.release(NAME, NAME, held)
    with pytest.raises(SafetyTrip, match=LOST):
        latch_of(str(testbed), in_process=False).refuse()
    with pytest.raises(SafetyTrip, match=words):
        latch.refuse_lost_runs(NAME)
