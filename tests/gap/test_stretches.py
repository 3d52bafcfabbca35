"""Runs that are longer than a diagnosis needs: what is looked at of them, what it costs, and that the answer stays."""

import os
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from leactl.gap.diagnose import diagnose, hold_out_runs, read_case
from leactl.gap.replay import long_runs
from leactl.gap.replay.long_runs import MOST_STRETCHES, fair_share, read_records
from leactl.model.nominal import BenchModel
from leactl.runfile.hdf5 import text_heaps
from tests.gap import nights

ROWS = 60_000
SECONDS, GIGABYTES = 30.0, 1.5  # of processor time, and of memory at once
NIGHT = 30_000_000


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Two runs of a joint with drag, whose model has none."""
    return written(tmp_path_factory.mktemp("nights"), ROWS, "drag")


def written(folder, rows, effect, runs=2):
    nights.write_model(folder / "nominal.yaml")
    for number in range(1, runs + 1):
        nights.write_night(folder / f"night-{number}.h5", rows, effect, number)
    return folder


def named(folder):
    diagnosis = diagnose(read_case(sorted(folder.glob("night-*.h5")), [], folder / "nominal.yaml"))
    return diagnosis, [cause.effect for cause in diagnosis.causes if cause.probability >= 0.5]


def test_what_some_do_not_need_is_for_the_others():
    assert fair_share([10.0, 1000.0, 400.0], 600.0) == 295.0
    assert fair_share([10.0, 20.0], 600.0) == np.inf


def test_a_run_within_its_share_is_read_whole(pair):
    (run,) = read_records([pair / "night-1.h5"], BenchModel())[pair / "night-1.h5"]
    assert (run.name, len(run.fast.time), run.notes) == ("night-1", ROWS, [])
    assert len(run.slow.time) == ROWS // 4  # means of four: temperatures need no more


def test_stretches_are_of_start_and_end_and_all_between_and_heat_of_every_sample(pair, monkeypatch):
    monkeypatch.setattr(long_runs, "MOST_ROWS", 1 << 14)
    monkeypatch.setattr(long_runs, "MOST_SLOW_ROWS", 1 << 10)
    whole, *several = read_records([pair / "night-1.h5"], BenchModel())[pair / "night-1.h5"]
    assert len(several) == MOST_STRETCHES
    assert sum(len(item.fast.time) for item in several) == 1 << 14
    begins = [float(item.fast.since_begin[0]) for item in several]
    assert begins[0] == 0.0
    assert several[-1].fast.time[-1] == ROWS / nights.RATE
    assert all(0.0 < apart < 2.1 * ROWS / nights.RATE / MOST_STRETCHES for apart in np.diff(begins))
    assert len({item.fast.fastest for item in several}) == 1
    assert {item.run for item in several} == {"night-1"}
    assert len({item.name for item in several}) == MOST_STRETCHES
    assert "16 stretches of 1.02 s of a run of 59.999 s are looked at (27 % of its rows)" in whole.notes[0]
    with h5py.File(pair / "night-1.h5") as file:
        current = file["streams/loop/q_axis_current"][:]
        stamps = file["streams/loop/time"][:]
    first = several[3].fast.time[0]
    assert np.array_equal(
        several[3].fast.values["q_axis_current", "test"], current[stamps >= first][: len(several[3].fast.time)]
    )
    edges = whole.slow.time[200:202]
    within = (stamps >= edges[0]) & (stamps < edges[1])
    assert whole.slow.driven["current_squared"][200] == pytest.approx(np.mean(current[within] ** 2))


def test_stretches_of_a_run_are_held_out_together(pair, monkeypatch):
    monkeypatch.setattr(long_runs, "MOST_ROWS", 1 << 14)
    records = [
        item for several in read_records(sorted(pair.glob("night-*.h5")), BenchModel()).values() for item in several
    ]
    fitted, held_out = hold_out_runs(records)
    assert ({fit.run for fit in fitted}, {item.run for item in held_out}) == ({"night-1"}, {"night-2"})
    parts = hold_out_runs(fitted)  # a run alone is parted: each of its stretches is
    assert [part.name for part in parts[0]] == [part.name for part in parts[1]]
    assert all(part.fast.all_valid(("angle", "test")).any() for part in parts[1] if part.fast is not None)


def test_a_clock_that_jumps_makes_no_rows_in_its_gap(pair, tmp_path):
    path = tmp_path / "jumps.h5"
    path.write_bytes((pair / "night-1.h5").read_bytes())
    with h5py.File(path, "r+") as file:
        stamps = file["streams/loop/time"]
        stamps[ROWS // 2 :] += 1e9
        for column in file["streams/loop"].values():
            del column.attrs["sha256"]
    records = read_records([path], BenchModel())[path]
    assert sum(len(record.fast.time) for record in records if record.fast is not None) <= ROWS
    assert all(np.ptp(record.fast.time) < ROWS / nights.RATE for record in records if record.fast is not None)


def test_stretches_whose_stamps_jitter_go_by_one_interval_and_say_so_once(pair, tmp_path, monkeypatch):
    monkeypatch.setattr(long_runs, "MOST_ROWS", 1 << 14)
    path = tmp_path / "jitters.h5"
    path.write_bytes((pair / "night-1.h5").read_bytes())
    with h5py.File(path, "r+") as file:
        stamps = file["streams/loop/time"]
        late = 0.2 / nights.RATE * np.random.default_rng(3).standard_normal(ROWS)
        stamps[...] = np.maximum.accumulate(stamps[...] + late) + 1e-9 * np.arange(ROWS)
        for column in file["streams/loop"].values():
            del column.attrs["sha256"]
    records = read_records([path], BenchModel())[path]
    intervals = {record.fast.interval for record in records if record.fast is not None}
    assert len(intervals) == 1
    interval = intervals.pop()
    assert interval == pytest.approx(1.0 / nights.RATE, rel=0.03)
    assert (
        sum(f"are uneven; values are taken in between at {1 / interval:.6g} Hz" in note for note in records[0].notes)
        == 1
    )


@pytest.mark.long
def test_an_effect_is_named_in_stretches_as_in_the_whole_run(pair, monkeypatch):
    monkeypatch.setattr(long_runs, "MOST_ROWS", 1 << 16)
    found, causes = named(pair)
    assert causes == ["quadratic_drag"]
    assert found.causes[0].parameters[0].value == pytest.approx(nights.DRAG, rel=0.01)
    assert any("stretches" in note for note in found.notes)


@pytest.mark.parametrize("size", [8, 9, 64, 4096])
def test_heaps_are_found_whatever_the_blocks_they_are_read_in(pair, monkeypatch, size):
    path = pair / "night-1.h5"
    raw = path.read_bytes()[:40_000] + 3 * (b"\0" * 5 + text_heaps.HEAD)
    part = pair / "part.bin"
    part.write_bytes(raw)
    monkeypatch.setattr(text_heaps, "SEARCH_BYTES", size)
    with part.open("rb") as stream:
        results = list(text_heaps.heaps(stream))
    assert results == [at for at in range(len(raw)) if raw.startswith(text_heaps.HEAD, at)]
    assert len(results) >= 3


@pytest.mark.long
@pytest.mark.parametrize(
    ("effect", "verdict", "causes"),
    [
        ("none", "calibration", []),
        ("drag", "effect", ["quadratic_drag"]),
        ("run-in", "effect", ["friction_run_in"]),
        ("clutch", "unknown", []),
    ],
)
@pytest.mark.parametrize("rows", [ROWS, 2_650_000])
def test_a_long_run_has_the_answer_of_a_short_one(tmp_path, rows, effect, verdict, causes):
    found, names = named(written(tmp_path, rows, effect))
    assert (found.verdict, names) == (verdict, causes)


@pytest.mark.long
@pytest.mark.parametrize(("rows", "runs"), [(2_650_000, 2), (5_000_000, 1), (NIGHT, 1)])
def test_memory_is_flat_in_the_rows(tmp_path, rows, runs):
    folder = written(tmp_path, rows, "drag", runs)
    files = sorted(folder.glob("night-*.h5"))
    size = sum(file.stat().st_size for file in files) / 1e6
    command = [sys.executable, "-m", "leactl", "gap", "diagnose", *files, "--model", folder / "nominal.yaml"]
    began = time.perf_counter()
    process = subprocess.Popen([*command, "--json", folder / "answer.json"], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    took, worked, memory = time.perf_counter() - began, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e6
    print(f"{runs} x {rows} rows, {size:.0f} MB: {took:.0f} s, {worked:.0f} s of a core, {memory:.2f} GB")
    for file in files:
        file.unlink()  # gigabytes
    assert process.returncode == 0
    assert memory < GIGABYTES
    assert rows == NIGHT or worked < SECONDS
