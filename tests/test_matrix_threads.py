"""How many threads NumPy's matrix products have in a process that imports leactl."""

import os
import subprocess
import sys

import pytest

ASKED = "import os; print(os.environ.get('OPENBLAS_NUM_THREADS'))"


@pytest.mark.parametrize(
    ("imports", "given", "expected"),
    [
        ("import leactl, numpy", None, "1"),
        ("import leactl.cli.main", None, "1"),
        ("import leactl.scheduler", None, "1"),
        ("import leactl, numpy", "3", "3"),  # whoever sets it is heeded
        ("import numpy, leactl", None, "None"),  # too late
        ("import numpy, leactl", "3", "3"),
    ],
)
def test_one_thread_where_leactl_is_imported_before_numpy(imports, given, expected):
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    environment |= {} if given is None else {"OPENBLAS_NUM_THREADS": given}
    done = subprocess.run(
        [sys.executable, "-c", f"{imports}; {ASKED}"], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == expected


@pytest.mark.skipif((os.cpu_count() or 1) < 2 or not os.path.isdir("/proc/self/task"), reason="one core, or not Linux")
def test_numpy_starts_no_thread_after_leactl():
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    code = "import leactl, numpy, os; numpy.ones((500, 500)) @ numpy.ones((500, 500)); "
    code += "print(len(os.listdir('/proc/self/task')))"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1"
