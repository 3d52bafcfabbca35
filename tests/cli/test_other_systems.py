"""What needs no device works where POSIX is missing: its modules and functions are taken away before leactl starts."""

import json
import os
import subprocess
import sys

import pytest

from leactl.bench import benchfile
from leactl.errors import InputError
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("other system")
    (folder / "sitecustomize.py").write_text(TAKEN_AWAY, encoding="utf-8")
    return folder


def leactl(folder, *arguments):
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": path, "LEACTL_STATE": str(folder / "state")}
    command = [sys.executable, "-m", "leactl", *map(str, arguments)]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def run(folder):
    """A run of the emulated bench that such a system made."""
    said = leactl(folder, "run", "position-step", "--bench", "emulated", "--out", folder / "runs", "--json")
    assert said.returncode == 0, said.stderr
    return json.loads(said.stdout)["run"]


def test_a_run_of_the_emulated_bench_is_whole_and_analysed(folder, run):
    for arguments in (["runs", "verify", run], ["analyze", run], ["runs", "show", run]):
        said = leactl(folder, *arguments)
        assert said.returncode == 0, said.stderr


@pytest.mark.parametrize(
    "command",
    ["protocol list", "protocol plan friction", "motor show lea", "gap effects", "runs list runs", "doctor --json"],
)
def test_what_is_offline_works(folder, run, command):
    said = leactl(folder, *command.split())
    assert "internal error" not in said.stderr
    assert said.returncode == 0 or command.startswith("doctor"), said.stderr


def test_text_of_other_systems_is_read(folder):
    plain = leactl(folder, "protocol", "show", "friction").stdout
    (folder / "of-windows.yaml").write_bytes(("\ufeff" + plain).encode().replace(b"\n", b"\r\n"))
    said = leactl(folder, "protocol", "plan", "of-windows.yaml")
    assert said.returncode == 0, said.stderr


def test_a_real_bench_wants_linux(monkeypatch):
    bench = benchfile.load("testbed")[0]
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(InputError, match="driven on Linux alone"), locks.held(bench, []):
        pass
