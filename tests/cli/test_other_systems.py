"""What needs no device works where POSIX is missing: its modules and functions are taken away before leactl starts."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from leactl.bench import benchfile
from leactl.errors import InputError
from leactl.runfile.read.reader import Run
from leactl.runner import locks

# what Windows' own Python has not, of what Linux has (Python 3.11, "Availability" in the pages of each module)
TAKEN_AWAY = """
import os, select, signal, sys, time

GONE = {"fcntl", "termios", "pty", "tty", "resource", "pwd", "grp", "syslog", "readline"}

class Gone:
    def find_spec(self, name, path=None, target=None):
        if name in GONE:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Gone())
MISSING = {
    os: "getuid geteuid mkfifo O_NONBLOCK O_NOFOLLOW O_CLOEXEC O_DIRECTORY fchmod fchown chown killpg setsid getpgid "
    "getpgrp tcgetpgrp openpty posix_fallocate posix_fadvise pread preadv pwrite pwritev memfd_create pidfd_open "
    "sched_setscheduler sched_setaffinity set_blocking",
    signal: "SIGHUP SIGQUIT SIGKILL SIGUSR1 SIGUSR2 SIGALRM SIGCHLD SIGPIPE pthread_sigmask setitimer",
    time: "clock_gettime CLOCK_BOOTTIME CLOCK_MONOTONIC",
    select: "poll epoll",
}
for module, names in MISSING.items():
    for name in names.split():
        delattr(module, name)
"""

MAP = """
mechanical: free
streams:
  loop:
    time: {column: "time [s]"}
    channels:
      q: {column: "test_theta [rad]", quantity: angle}
"""
USE = """
import sys
import leactl

done = leactl.run_protocol("position-step", settings={"trials": 1}, condition="design", out="by-python")
with leactl.open_run(done.run) as run:
    values = len(run["angle", "test"])
replayed = leactl.simulate(sys.argv[1], done.run)
print(done.status, leactl.analyze(done.run).experiment, values > 0 and replayed.path.is_file())
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("other system")
    (folder / "sitecustomize.py").write_text(TAKEN_AWAY, encoding="utf-8")
    return folder


def python(folder, *words):
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": path, "LEACTL_STATE": str(folder / "state")}
    command = [sys.executable, *map(str, words)]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def leactl(folder, *arguments):
    return python(folder, "-m", "leactl", *arguments)


@pytest.fixture(scope="module")
def run(folder):
    """A run of the emulated bench that such a system made."""
    completed = leactl(folder, "run", "position-step", "--bench", "emulated", "--out", folder / "runs", "--json")
    assert completed.returncode == 0, completed.stderr
    return json.loads(completed.stdout)["run"]


def test_a_run_of_the_emulated_bench_is_whole_and_analysed(folder, run):
    for arguments in (["runs", "verify", run], ["analyze", run], ["runs", "show", run]):
        completed = leactl(folder, *arguments)
        assert completed.returncode == 0, completed.stderr


@pytest.mark.parametrize(
    "command",
    ["protocol list", "protocol plan friction", "motor show lea", "gap effects", "runs list runs", "doctor --json"],
)
def test_what_is_offline_works(folder, run, command):
    completed = leactl(folder, *command.split())
    assert "internal error" not in completed.stderr
    assert completed.returncode == 0 or command.startswith("doctor"), completed.stderr


@pytest.mark.long
def test_a_run_is_reported_and_indexed(folder, run):
    completed = leactl(folder, "report", run, "--html", "sheet.html")
    assert completed.returncode == 0, completed.stderr
    assert "position step" in (folder / "sheet.html").read_text(encoding="utf-8").lower()
    completed = leactl(folder, "runs", "index", "runs")
    assert completed.returncode == 0, completed.stderr
    listed = leactl(folder, "runs", "list", "runs", "--where", "protocol == 'position-step'", "--json")
    assert (len(json.loads(listed.stdout)["runs"]), listed.stderr) == (1, "")


def test_what_is_exported_is_imported_again(folder, run):
    completed = leactl(folder, "runs", "export", run, "--format", "csv", "--out", "csv")
    assert completed.returncode == 0, completed.stderr
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    completed = leactl(folder, "runs", "import", "csv/*.loop.csv", "--map", "map.yaml", "--out", "imported")
    assert completed.returncode == 0, completed.stderr
    [imported] = (folder / "imported").glob("*.h5")
    with Run.open(folder / run) as before, Run.open(imported) as after:
        np.testing.assert_array_equal(after["angle"].values, before["angle"].values)


@pytest.fixture(scope="module")
def model(folder):
    (folder / "nominal.yaml").write_text(leactl(folder, "bench", "model", "emulated").stdout, encoding="utf-8")
    return "nominal.yaml"


@pytest.mark.long
def test_a_gap_is_diagnosed(folder, model):
    few = ("--set", "trials=1", "--set", "levels_A=[4.9, 9.8]", "--set", "rest_s=3")
    for name in ("fit", "held"):
        completed = leactl(folder, "run", "torque-constant", *few, "--out", name)
        assert completed.returncode == 0, completed.stderr
    fit, held = (next((folder / name).glob("*.h5")) for name in ("fit", "held"))
    completed = leactl(
        folder, "gap", "diagnose", fit, "--held-out", held, "--model", model, "--html", "gap.html", "--json"
    )
    assert completed.returncode == 0, completed.stderr
    assert json.loads(completed.stdout)["verdict"] == "none"
    assert (folder / "gap.html").is_file()


@pytest.mark.long
def test_python_makes_opens_analyses_and_replays_a_run(folder, model):
    (folder / "use.py").write_text(USE, encoding="utf-8")
    said = python(folder, "use.py", model)
    assert (said.returncode, said.stdout) == (0, "complete position-step True\n"), said.stderr


def test_the_page_of_a_run_is_refused_at_the_door(folder):
    completed = leactl(folder, "run", "position-step", "--web", "--out", "shown")
    assert (completed.returncode, completed.stdout) == (2, "")
    assert completed.stderr == "leactl: --web: the page of a run is served on POSIX systems alone\n"
    assert not (folder / "shown").exists()


def test_text_of_other_systems_is_read(folder):
    plain = leactl(folder, "protocol", "show", "friction").stdout
    (folder / "of-windows.yaml").write_bytes(("\ufeff" + plain).encode().replace(b"\n", b"\r\n"))
    completed = leactl(folder, "protocol", "plan", "of-windows.yaml")
    assert completed.returncode == 0, completed.stderr


def test_a_real_bench_wants_linux(monkeypatch):
    bench = benchfile.load("testbed")[0]
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(InputError, match="driven on Linux alone"), locks.held(bench, []):
        pass
