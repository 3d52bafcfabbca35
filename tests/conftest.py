"""What every test starts from: processes that heed Ctrl-C, examples that take what they take, a bench that is held."""

import signal
import subprocess
import sys

import pytest
from hypothesis import settings

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
    settings.register_profile("untimed", deadline=None)  # how long an example takes says how busy the machine is
    settings.load_profile("untimed")


WALL_CLOCK = {"driver", "kills"}
"""Directories of tests whose far ends answer from other processes within a time: nothing is to run beside these."""


@pytest.hookimpl(tryfirst=True)  # before `-m` is looked at
def pytest_collection_modifyitems(items):
    for item in items:
        if WALL_CLOCK.intersection(item.path.relative_to(item.config.rootpath).parts):
            item.add_marker(pytest.mark.wall_clock)


@pytest.fixture
def holder():
    """A process that holds the bench `testbed`."""
    process = subprocess.Popen([sys.executable, "-c", HOLD], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()
