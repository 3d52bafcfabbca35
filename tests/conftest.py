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


@pytest.fixture
def holder():
    """A process that holds the bench `testbed`."""
    process = subprocess.Popen([sys.executable, "-c", HOLD], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()
