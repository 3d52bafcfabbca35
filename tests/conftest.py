"""What every test starts from: processes that heed Ctrl-C, examples that take what they take, a bench that is held."""

import signal
import subprocess
import sys

import pytest
from hypothesis import settings

from leactl.analysis.estimate import Result
from leactl.analysis.experiments import is_known, results_of

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


# units of a linear axis of a foreign rig, which an analysis takes over; a result is declared for a turning one
LINEAR = {"N": "N*m", "N/A": "N*m/A", "N*s/m": "N*m*s/rad", "N*s^2/m^2": "N*m*s^2/rad^2", "kg": "kg*m^2"}


@pytest.fixture(scope="session", autouse=True)
def results_are_declared():
    """Every result that any test gets from an experiment is one that the experiment declares, in its unit."""
    made = Result.__init__

    def checked(self, *args, **kwargs):
        made(self, *args, **kwargs)
        declared = results_of(self.experiment) if is_known(self.experiment) else {}
        for item in self.results if declared else ():
            units = {item.units, LINEAR.get(item.units, item.units)}
            assert declared.get(item.name) in units, f"{self.experiment}: {item.name} [{item.units}] is not declared"

    Result.__init__ = checked
    yield
    Result.__init__ = made
