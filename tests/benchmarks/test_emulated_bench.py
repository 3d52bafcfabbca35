"""Emulated benches beside real time, in CPU time: they never wait, and other processes do not count."""

import statistics
import time
from contextlib import nullcontext

import numpy as np
import pytest

from leactl.bench import benchfile
from leactl.emulation.plant.phase_lanes import PhaseLane, PhaseLanes
from leactl.runner.operators import confirm_at_once
from leactl.runner.request import prepare
from leactl.runner.session import execute

FAST = """
name: fast
setup: coupled
rate_Hz: 1000
record_Hz: 1000
steps:
  - mode: {test: current, load: angle}
  - hold: {role: test, current_A: 2.0, duration_s: 10}
  - mode: {test: off, load: off}
"""
HEATED = """
name: heated
setup: heated
rate_Hz: 30
record_Hz: 30
steps:
  - hold: {duration_s: 900}
"""
RESOLVED = "    phase_resolved: true\n    friction_heat: true\n"


@pytest.mark.parametrize(
    ("protocol", "settings", "limit", "what"),
    [
        (FAST, "", 1.0, "both drives at 1 kHz, torque sensor, plant"),
        (FAST, RESOLVED, 1.0, "the same with phases resolved"),
        (HEATED, "", 300.0, "heated bench at 30 Hz"),
    ],
    ids=["fast", "phases", "heated"],
)
def test_a_bench_runs_faster_than_real_time(tmp_path, monkeypatch, figure, protocol, settings, limit, what):
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    path = tmp_path / "protocol.yaml"
    path.write_text(protocol)
    shipped = (benchfile.SHIPPED / "emulated.yaml").read_text()
    bench = tmp_path / "bench.yaml"
    bench.write_text(shipped.replace("  bench:\n", f"  bench:\n{settings}", 1))
    speeds = []
    for _ in range(5):
        request = prepare(str(path), str(bench), [], "", "design", "", tmp_path / "runs", realtime=False)
        began = time.process_time()
        outcome = execute(request, confirm_at_once, lambda _progress: nullcontext())
        speeds.append(outcome.duration_s / (time.process_time() - began))
        assert outcome.error is None
    speed = statistics.median(speeds)
    figure(f"emulated bench, {what}: {speed:.3g} times real time, the file's close included; limit {limit:g}")
    assert speed >= limit


def test_many_lanes_of_heat_take_little_of_a_monte_carlo(figure):
    random = np.random.default_rng(1)
    shape = (60000, 200)  # 600 s by 10 ms
    current, velocity = random.uniform(-10.0, 10.0, shape), random.uniform(-30.0, 30.0, shape)
    times = []
    for _ in range(3):
        lanes = PhaseLanes([PhaseLane()] * 200)
        began = time.process_time()
        lanes.run(current, velocity)
        times.append(time.process_time() - began)
    taken = statistics.median(times)
    figure(f"phases of 200 lanes over 600 s by 10 ms: {taken:.3g} s of CPU; limit 5")
    assert taken <= 5.0
