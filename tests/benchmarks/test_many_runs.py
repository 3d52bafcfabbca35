"""Ten thousand runs indexed and asked about, and a thousand analysed by one process and by two."""

import os
import shutil
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from leactl import run_protocol
from leactl.processes import Workers
from leactl.quantities import ChannelSpec
from leactl.runfile.catalog.run_index import NAME, list_runs, update
from leactl.runfile.catalog.selection import selection_of
from leactl.runfile.write.run_info import RunInfo
from leactl.runfile.write.writer import RunWriter
from tests.benchmarks.test_recording import CHANNELS

RUNS, ANALYSED = 10_000, 1_000
LEAST_RUNS_PER_S = 200
MOST_QUERY_S, MOST_LIST_S = 0.05, 0.4  # CPU time
LEAST_GAIN, MOST_LOAD = 1.8, 0.5  # by two processes, where this much else is done
AGE_S = 3600.0  # so that no file is taken for young
KINDS = [("friction", "loaded"), ("friction", "design"), ("coast-down", "loaded"), ("back-emf", "unloaded")]
LATER = [ChannelSpec("torque", "torque", "test", "torque_sensor")]
EXPRESSION = "condition == 'loaded' and experiment == 'friction' and hold_s < 2 and created >= '2026-11-01'"


def small_runs(folder, count):
    """Runs of 1,000 rows, of some protocols and conditions; all but the first of each kind are copies."""
    time_s = np.arange(1, 1001) * 1e-3
    made = []
    for number, (protocol, condition) in enumerate(KINDS):
        info = RunInfo(
            run_id=f"20261120T10153{number}Z-{protocol}-7f3a",
            protocol=protocol,
            bench="emulated",
            actuator="LEA-1",
            condition=condition,
            operator="Ada",
            simulated=True,
            mechanical="coupled",
            software="leactl 0.1.0",
            created=f"2026-11-20T10:15:3{number}Z",
            sources={"protocol": f"name: {protocol}\n" + "# a line of a protocol\n" * 60},
            parameters={"hold_s": number + 1, "levels_A": [1.0, 2.0, 3.0], "trials": 5},
        )
        with RunWriter(folder, info, {"loop": CHANNELS, "torque_sensor": LATER}) as writer:
            writer.append("loop", time_s, np.zeros((1000, len(CHANNELS))))
            writer.append("torque_sensor", time_s, np.zeros((1000, 1)))
            writer.step("hold", 0.1, 0.9, 0.0, {"current_A": 3.0})
        made.append(writer.path)
    made += [shutil.copyfile(made[number % 4], folder / f"run-{number:05}.h5") for number in range(4, count)]
    then = time.time() - AGE_S
    for path in made:
        os.utime(path, (then, then))


def cpu_s(work, rounds=5):
    """The least CPU time of some rounds: what other processes take or slow down is not the work's."""
    taken = []
    for _ in range(rounds):
        began = time.process_time()
        work()
        taken.append(time.process_time() - began)
    return min(taken)


def all_cpu_s():
    """CPU time of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def test_ten_thousand_runs_are_indexed_and_asked(tmp_path, figure):
    small_runs(tmp_path, RUNS)
    cores = os.cpu_count() or 1
    began, cpu_began = time.monotonic(), all_cpu_s()
    with Workers(cores) as workers:
        _, catalogue = update(tmp_path, workers=workers)
    wall, cpu = time.monotonic() - began, all_cpu_s() - cpu_began
    assert (catalogue.read, len(catalogue.runs)) == (RUNS, RUNS)
    runs = list_runs(tmp_path, remark=pytest.fail)
    asked = []

    def ask():
        chosen = selection_of(runs, where=[EXPRESSION])
        asked[:] = [run for run in runs if chosen.fits(run)]

    query, listed = cpu_s(ask), cpu_s(lambda: list_runs(tmp_path, remark=pytest.fail))
    assert len(asked) == RUNS // 4
    words = ["runs", "list", str(tmp_path), "--where", f"{EXPRESSION} and like(file, 'run-00*')"]
    before = all_cpu_s()
    shown = subprocess.run([sys.executable, "-m", "leactl", *words], capture_output=True, text=True, check=True)
    whole = all_cpu_s() - before
    rate, size = cores * RUNS / cpu, (tmp_path / NAME).stat().st_size / 2**20
    figure(f"index of {RUNS} runs, {size:.1f} MiB: {RUNS / wall:.0f} runs/s beside other work, by {cores} processes")
    figure(f"the same on {cores} free cores, by its CPU time: {rate:.0f} runs/s; at least {LEAST_RUNS_PER_S}")
    figure(f"a query over them: {query * 1e3:.0f} ms of CPU time; at most {MOST_QUERY_S * 1e3:.0f} ms")
    figure(f"the list anew, every file looked at and none opened: {listed * 1e3:.0f} ms of CPU time")
    figure(f"the command `runs list --where`: {whole:.2f} s of CPU time; at most {MOST_LIST_S} s")
    assert len(shown.stdout.splitlines()) == 249
    assert rate >= LEAST_RUNS_PER_S
    assert query <= MOST_QUERY_S
    assert whole <= MOST_LIST_S


@pytest.mark.long
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core")
def test_two_processes_analyse_a_thousand_runs_sooner(tmp_path, figure, monkeypatch):
    busy = os.getloadavg()[0]
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    quick = {"trials": 2, "hold_s": 3, "settle_s": 1}
    first = run_protocol("friction", settings=quick, condition="design", out=tmp_path / "first").run
    folder = tmp_path / "runs"
    folder.mkdir()
    for number in range(ANALYSED):
        path = shutil.copyfile(first, folder / f"friction-{number:04}.h5")
        with h5py.File(path, "r+") as file:
            del file["seal"], file.attrs["seal"]  # which holds the attributes
            file.attrs["run_id"] = f"friction-{number:04}"
            file.attrs["created"] = f"2026-11-{1 + number // 60:02}T10:{number % 60:02}:00Z"
    seconds, answers = [], []
    for processes in ("1", "2"):
        began = time.monotonic()
        words = ["runs", "trend", "coulomb_friction", str(folder), "--json", "--processes", processes]
        done = subprocess.run([sys.executable, "-m", "leactl", *words], capture_output=True, check=True)
        seconds.append(time.monotonic() - began)
        answers.append(done.stdout)
    one, two = seconds
    figure(f"{ANALYSED} friction runs by one process: {one:.0f} s, by two: {two:.0f} s, {one / two:.2f} times as fast")
    figure(f"beside a load of {busy:.1f} on {os.cpu_count()} cores; at least {LEAST_GAIN} where they are free")
    assert answers[0] == answers[1]
    if busy > MOST_LOAD:
        pytest.skip(f"a load of {busy:.1f}; two processes are judged below {MOST_LOAD}")
    assert one / two >= LEAST_GAIN
