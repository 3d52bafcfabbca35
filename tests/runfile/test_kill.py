"""A recording that another process watches, or that is killed or runs out of disk, keeps every flushed row."""

import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from leactl.runfile.publish import NotWritten
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import recover, verify
from leactl.runfile.write.writer import RecordingFailed, RunWriter

from .specimen import STREAMS, info

TESTS = Path(__file__).resolve().parents[1]
KILLS = 10
KILLS_LONG = 500
ROWS_PER_FLUSH = (1, 7, 100, 5000)


@contextmanager
def recording(directory: Path, rows_per_flush: int = 100, limit: int = 0) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "runfile.recording", str(directory), str(rows_per_flush), str(limit)]
    path = os.pathsep.join([str(TESTS.parent), str(TESTS)])
    environment = {**os.environ, "PYTHONPATH": path}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stdout
            assert process.stdout.readline() == "started\n"
            yield process
        finally:
            process.kill()


def flushed_rows(process: subprocess.Popen[str], lines: int) -> int:
    """Rows that the recording says are on the disk, after so many flushes."""
    assert process.stdout
    said = [process.stdout.readline() for _ in range(lines)]
    return int(said[-1].split()[1]) if said else 0


def check_rows(path: Path, at_least: int) -> int:
    with Run.open(path) as run:
        channels = [run.channel("q_axis_current"), run.channel("angle"), run.channel("torque")]
        rows = np.arange(len(channels[0].time))
        assert len(rows) >= at_least
        for channel, expected in zip(channels, [rows, rows + 0.25, -rows], strict=True):
            np.testing.assert_array_equal(channel.time, rows * 1e-3)
            np.testing.assert_array_equal(channel.values, expected)
        assert all(step.parameters["long"] == "ü" * 100 for step in run.steps)
        assert all(event.message == "größer" for event in run.events)
        if at_least:
            assert run.steps[-1].stop >= (at_least - 1) * 1e-3
        return len(rows)


def kill_within_a_flush(directory: Path, seed: int) -> int:
    """Rows that were said to be on the disk when the recording was killed."""
    chance = random.Random(seed)
    with recording(directory, chance.choice(ROWS_PER_FLUSH)) as process:
        said = flushed_rows(process, chance.randrange(1, 12))
        # the next one is under way since the line was read
        for _ in range(chance.randrange(20_000)):
            pass
        return max(said, rows_said_until_killed(process))


def kill_at_any_moment(directory: Path, seed: int) -> int:
    """The same at a moment of the first half second, before the first flush too."""
    chance = random.Random(seed)
    with recording(directory, chance.choice(ROWS_PER_FLUSH)) as process:
        time.sleep(chance.uniform(0.0, 0.5) ** 2 * 2)  # more of them early, where files are still small and new
        return rows_said_until_killed(process)


def rows_said_until_killed(process: subprocess.Popen[str]) -> int:
    process.kill()
    assert process.stdout
    lines = [line for line in process.stdout if line.endswith("\n") and line.startswith("flushed ")]
    return int(lines[-1].split()[1]) if lines else 0


def check_and_recover(directory: Path, said: int) -> int:
    """Rows that are there: all that were said, and as many after as before the recovery."""
    (path,) = directory.iterdir()
    rows = check_rows(path, said)
    assert any("incomplete recording" in finding for finding in verify(path))
    before = path.read_bytes()
    clean = recover(path)
    assert path.read_bytes() == before
    assert verify(clean) == []
    assert check_rows(clean, said) == rows
    with Run.open(clean) as run:
        assert run.status == "recovered"
    return rows


@pytest.mark.parametrize("seed", range(KILLS))
def test_a_kill_loses_no_flushed_row(tmp_path: Path, seed: int):
    check_and_recover(tmp_path, kill_within_a_flush(tmp_path, seed))


@pytest.mark.long
def test_five_hundred_kills(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    results = []
    for seed in range(KILLS_LONG):
        directory = tmp_path / str(seed)
        directory.mkdir()
        said = (kill_at_any_moment if seed % 2 else kill_within_a_flush)(directory, 1000 + seed)
        results.append((said, check_and_recover(directory, said)))
        shutil.rmtree(directory)
    before, within = sum(said == 0 for said, _ in results), sum(there > said for said, there in results)
    with capsys.disabled():
        print(f"\n{len(results)} kills, {before} before a flush had returned, {within} with rows of one under way:")
        print(f"all readable, named as incomplete and recovered, {sum(there for _, there in results)} rows in all")


def test_another_process_may_watch(tmp_path: Path):
    with recording(tmp_path) as process:
        (path,) = tmp_path.iterdir()
        seen = 0
        for lines in (1, 3, 9):
            said = flushed_rows(process, lines)
            seen = check_rows(path, max(said, seen))
        with Run.open(path) as run:
            assert (run.status, run.unfinished) == ("recording", True)


@pytest.mark.parametrize("limit", [2_000_000, 3_333_333, 5_000_001])
def test_a_file_that_may_not_grow_keeps_what_it_has(tmp_path: Path, limit: int):
    with recording(tmp_path, limit=limit) as process:
        assert process.stdout
        lines = process.stdout.read().splitlines()
        assert process.wait() == 0
    assert lines[-1].startswith(f"failed {tmp_path}")
    (path,) = tmp_path.iterdir()
    said = int(lines[-2].split()[1])
    rows = check_rows(path, said)
    clean = recover(path)
    assert verify(clean) == []
    assert check_rows(clean, said) == rows


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 4 MiB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("mounting a small file system needs root")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


def test_a_full_disk_keeps_what_it_has(small_disk: Path):
    with recording(small_disk) as process:
        assert process.stdout
        lines = process.stdout.read().splitlines()
        assert process.wait() == 0
    (path,) = small_disk.iterdir()
    assert "No space left on device" in lines[-1]
    check_rows(path, int(lines[-2].split()[1]))


def test_a_disk_without_room_for_the_repacked_copy_keeps_the_live_file(small_disk: Path, tmp_path: Path, monkeypatch):
    noise = np.random.default_rng(1).normal(size=(80_000, 3))
    writer = RunWriter(small_disk, info(), STREAMS)
    writer.append("loop", np.arange(80_000) * 1e-3, noise)
    writer.flush()
    with pytest.raises(RecordingFailed, match="No space left"):
        writer.close("complete")
    assert list(small_disk.iterdir()) == [writer.path]
    # this process has the file open still, as none has that a full disk has ended
    monkeypatch.setattr("leactl.runfile.verify.integrity.is_being_written", lambda path: False)
    with pytest.raises(NotWritten, match="No space left"):
        recover(writer.path)
    elsewhere = shutil.copy(writer.path, tmp_path)
    with Run.open(recover(Path(elsewhere))) as run:
        np.testing.assert_array_equal(run.channel("angle").values, noise[:, 1])


def test_a_recording_does_not_start_on_a_full_disk(small_disk: Path):
    filler = small_disk / "filler"
    filler.write_bytes(bytes(shutil.disk_usage(small_disk).free - 50_000))
    with pytest.raises(RecordingFailed, match="cannot create the run file"):
        RunWriter(small_disk, info(), STREAMS)
    assert list(small_disk.iterdir()) == [filler]
