"""What every test starts from: processes that heed Ctrl-C, and one that holds a bench for whoever wants it held."""

import signal
import subprocess
import sys

import pytest

HOLD = """
import sys, time
from leactl.bench import benchfile
from leactl.runner import exclusive
file, devices, _ = benchfile.load("testbed")
with exclusive.held(file, devices):
    print("held", flush=True)
    time.sleep(60)
"""


def pytest_configure():
    # a script's background job begins with SIGINT ignored, and so would every process that a test starts
    signal.signal(signal.SIGINT, signal.default_int_handler)


WALL_CLOCK = ("bench", "cli", "driver", "emulation", "kills", "runfile", "runner")
"""Directories of tests whose processes, threads or buses go by the wall's clock: never two of these at once."""


@pytest.hookimpl(tryfirst=True)  # xdist reads the marks in a hook of its own
def pytest_collection_modifyitems(items):
    """Groups for `pytest -n 2 --dist loadgroup`: what goes by the wall's clock, and what shares a dear fixture."""
    for item in items:
        place = item.path.relative_to(item.config.rootpath).parts
        group = "wall clock" if place[1] in WALL_CLOCK else str(item.path) if place[1] == "gap" else None
        if group:
            item.add_marker(pytest.mark.xdist_group(group))


@pytest.fixture
def holder():
    """A process that holds the bench `testbed`."""
    process = subprocess.Popen([sys.executable, "-c", HOLD], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()
