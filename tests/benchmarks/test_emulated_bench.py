"""Emulated benches beside real time, in CPU time: they never wait, and other processes do not count."""

import statistics
import time
from contextlib import nullcontext

import pytest

from leactl.runner.operators import granted
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


@pytest.mark.parametrize(
    ("protocol", "limit", "what"),
    [(FAST, 1.0, "both drives at 1 kHz, torque sensor, plant"), (HEATED, 300.0, "heated bench at 30 Hz")],
)
def test_a_bench_runs_faster_than_real_time(tmp_path, monkeypatch, figure, protocol, limit, what):
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    path = tmp_path / "protocol.yaml"
    path.write_text(protocol)
    speeds = []
    for _ in range(5):
        request = prepare(str(path), "emulated", [], "", "design", "", tmp_path / "runs", realtime=False)
        began = time.process_time()
        outcome = execute(request, granted, lambda _progress: nullcontext())
        speeds.append(outcome.duration_s / (time.process_time() - began))
        assert outcome.error is None
    speed = statistics.median(speeds)
    figure(f"emulated bench, {what}: {speed:.3g} times real time, the file's close included; limit {limit:g}")
    assert speed >= limit
