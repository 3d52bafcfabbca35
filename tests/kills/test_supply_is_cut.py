"""A run that heats through two leads is killed, or hangs: its watchdog switches the supply off, by the plant itself."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.terminal import COMMAND

ROOT = Path(__file__).parents[2]
PROTOCOL = """
name: heat
setup: heated
rate_Hz: 30
steps:
  - supply: {test: {voltage_V: 8, current_A: 8}}
  - hold: {name: heating, duration_s: 60}
  - supply: {test: off}
"""


@pytest.fixture
def served():
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.kills.heated"], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    yield process, json.loads(process.stdout.readline()).split()[-1]
    process.send_signal(signal.SIGINT)
    process.wait()
    process.stdout.close()


@pytest.mark.parametrize(
    ("how", "said"),
    [
        pytest.param(signal.SIGKILL, "leactl watchdog: supply: output off, 0.00 V and 0.00 A", id="killed"),
        # the line is still held by the run, which has to be woken and ended first
        pytest.param(signal.SIGSTOP, "stopped by SIGTERM", id="hung", marks=pytest.mark.long),
    ],
)
def test_the_current_ends_when_the_run_cannot_end_it(served, tmp_path, how, said):
    bench, line = served
    (tmp_path / "heat.yaml").write_text(PROTOCOL)
    command = ["run", "heat.yaml", "--bench", "emulated-heated", "--served", f"--bus=supply0=serial:{line}"]
    environment = os.environ | {"LEACTL_STATE": str(tmp_path / "state")}
    run = subprocess.Popen(
        [*COMMAND, *command], cwd=tmp_path, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL
    )
    try:
        assert json.loads(bench.stdout.readline()) == {"flowing": True}
        run.send_signal(how)
        assert json.loads(bench.stdout.readline()) == {"flowing": False}
        told = run.stderr.read().decode()
    finally:
        run.kill()
        run.wait()
        run.stderr.close()
    assert said in told
