"""A run that heats through two leads is killed, or hangs: its watchdog switches the supply off, by the plant itself.

Where the watchdog is killed with it, the supply's own protection does.
"""

import json
import os
import select
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

from leactl.bench import benchfile
from tests.cli.terminal import COMMAND
from tests.kills.trial import watchdog_of

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


@contextmanager
def heated(bench):
    """A served bench of heated leads, and its serial line."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.kills.heated", bench], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    yield process, json.loads(process.stdout.readline()).split()[-1]
    process.send_signal(signal.SIGINT)
    process.wait()
    process.stdout.close()


@pytest.fixture
def served():
    with heated("emulated-heated") as bench:
        yield bench


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
    assert said in told_when_ended(bench, "emulated-heated", f"supply0=serial:{line}", tmp_path, how)


def test_the_current_of_a_supply_on_the_network_ends_when_the_run_is_killed(tmp_path):
    """The connection of the dead run is dropped, and the watchdog makes one of its own."""
    file = bench_with_scpi(current_limit_A=10)
    file["buses"]["supply0"] = {"kind": "visa", "resource": "TCPIP::192.168.0.5::5555::SOCKET"}
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(file))
    with heated(str(path)) as (bench, resource):
        told = told_when_ended(bench, "bench.yaml", f"supply0=visa:{resource}", tmp_path, signal.SIGKILL)
    assert "leactl watchdog: supply: output off, 0.000 A" in told


def bench_with_scpi(**limit):
    """The keys of a bench whose leads are heated by a supply that speaks SCPI."""
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated-heated.yaml").read_text())
    del bench["devices"]["camera"]
    settings = {"dialect": "e36xx", "model": "E3633A", "feeds": "leads", "voltage_limit_V": 8, **limit}
    bench["devices"]["supply"] = {"driver": "scpi_supply", "bus": "supply0", "role": "test", "settings": settings}
    return bench


def told_when_ended(bench, name, bus, tmp_path, how):
    """What a run on a served bench leaves on stderr that gets this signal while the current flows."""
    (tmp_path / "heat.yaml").write_text(PROTOCOL)
    command = ["run", "heat.yaml", "--bench", name, "--served", f"--bus={bus}"]
    environment = os.environ | {"LEACTL_STATE": str(tmp_path / "state")}
    run = subprocess.Popen(
        [*COMMAND, *command], cwd=tmp_path, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL
    )
    try:
        assert json.loads(bench.stdout.readline()) == {"flowing": True}
        run.send_signal(how)
        assert json.loads(bench.stdout.readline()) == {"flowing": False}
        return run.stderr.read().decode()
    finally:
        run.kill()
        run.wait()
        run.stderr.close()


def test_the_current_ends_where_run_and_watchdog_are_both_killed(tmp_path):
    """13 A at 8 V warm the winding to where the protection is within two seconds."""
    bench = bench_with_scpi(current_limit_A=14)
    bench["limits"]["current_A"] = 20
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench))
    hot = PROTOCOL.replace("current_A: 8", "current_A: 13").replace("duration_s: 60", "duration_s: 10")
    (tmp_path / "heat.yaml").write_text(hot)
    with heated(str(tmp_path / "bench.yaml")) as (bench, line):
        command = ["run", "heat.yaml", "--bench", "bench.yaml", "--served", f"--bus=supply0=serial:{line}"]
        environment = os.environ | {"LEACTL_STATE": str(tmp_path / "state")}
        run = subprocess.Popen([*COMMAND, *command], cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL)
        try:
            assert json.loads(bench.stdout.readline()) == {"flowing": True}
            for process in (watchdog_of(run.pid), run.pid):
                os.kill(process, signal.SIGKILL)
            assert select.select([bench.stdout], [], [], 30.0)[0], "the current flows on"
            assert json.loads(bench.stdout.readline()) == {"flowing": False}
        finally:
            run.kill()
            run.wait()
