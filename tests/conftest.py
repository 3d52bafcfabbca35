"""What every test starts from: processes that heed Ctrl-C, examples that take what they take, a bench that is held."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

# as the command does, before NumPy comes: threads that wait for a taken core burn a third of the time
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

from leactl.analysis.analyze import is_known, results_of
from leactl.analysis.estimate import Result
from leactl.bench import benchfile

HOLD = """
import sys, time
from leactl.bench import benchfile
from leactl.runner import locks
file, devices, _ = benchfile.load(sys.argv[1])
with locks.held(file, devices):
    print("held", flush=True)
    time.sleep(60)
"""


def pytest_configure(config):
    # a script's background job begins with SIGINT ignored, and so would every process that a test starts
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # nothing that a test latches or heats is this machine's
    machine = tempfile.TemporaryDirectory(prefix="leactl-tests-")
    config.add_cleanup(machine.cleanup)
    os.environ["LEACTL_MACHINE_STATE"] = machine.name
    # how long an example takes says how busy the machine is; a change is judged on the same examples every time, since
    # one in thousands of random recordings is read wrongly by chance
    settings.register_profile("fixed", deadline=None, derandomize=True)
    settings.register_profile("drawn", parent=settings.get_profile("fixed"), derandomize=False)
    settings.load_profile(config.getoption("hypothesis_profile", None) or "fixed")


WALL_CLOCK = {"driver", "kills"}
"""Directories of tests whose far ends answer from other processes within a time: nothing is to run beside these."""


@pytest.hookimpl(tryfirst=True)  # before `-m` is looked at
def pytest_collection_modifyitems(items):
    for item in items:
        if WALL_CLOCK.intersection(item.path.relative_to(item.config.rootpath).parts):
            item.add_marker(pytest.mark.wall_clock)


@pytest.fixture
def testbed(tmp_path, monkeypatch):
    """The bench file `testbed` under a name and on buses that no other test at the same time has, on a new machine."""
    monkeypatch.setenv("LEACTL_MACHINE_STATE", str(tmp_path / "machine"))
    text = (benchfile.SHIPPED / "testbed.yaml").read_text()
    number = os.getpid()
    changes = {
        "name: testbed": f"name: testbed-{number}",
        "channel: can0": f"channel: can{number}",
        "kind: i2c, number: 1": f"kind: i2c, number: {number % 199 + 56}",
    }
    for before, after in changes.items():
        assert before in text
        text = text.replace(before, after)
    path = tmp_path / "testbed.yaml"
    path.write_text(text)
    return path


@pytest.fixture
def holder(testbed):
    """A process that holds the bench `testbed`."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(testbed)], stdout=subprocess.PIPE, text=True)
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
        analysed = is_known(self.experiment) and all(Path(run).is_file() for run in self.runs)  # and not invented
        declared = results_of(self.experiment) if analysed else {}
        for item in self.results if declared else ():
            units = {item.units, LINEAR.get(item.units, item.units)}
            assert declared.get(item.name) in units, f"{self.experiment}: {item.name} [{item.units}] is not declared"

    Result.__init__ = checked
    yield
    Result.__init__ = made
