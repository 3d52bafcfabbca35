"""The wire tests once more over SocketCAN and I2C of a real kernel, which a virtual machine boots for them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from .transports import ROOT

TOOL = Path(os.environ.get("LEACTL_KERNEL_BENCH", ROOT.parent / "shared" / "tools" / "kernel-bench"))
HIDDEN = [Path(folder) for folder in ("/tmp", "/run", "/mnt", "/dev/shm")]  # fresh file systems in there
BUSES = ["LEACTL_TEST_CAN=socketcan:vcan0", "LEACTL_TEST_I2C=0", "PYTHONDONTWRITEBYTECODE=1"]
TESTS = ["tests/driver", "tests/emulation/test_serving.py", "-k", "kernel"]


@pytest.mark.long
@pytest.mark.skipif(not TOOL.is_file(), reason=f"no {TOOL}; LEACTL_KERNEL_BENCH says where it is")
@pytest.mark.skipif(
    any(place.is_relative_to(folder) for place in (ROOT, Path(sys.prefix)) for folder in HIDDEN),
    reason="the kernel bench does not see this checkout or its environment; make it at .venv, outside /tmp",
)
def test_the_wire_tests_pass_on_vcan0_and_i2c_stub():
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--color=no", "-v", *TESTS]
    done = subprocess.run(
        [TOOL, "env", *BUSES, *command],
        cwd=ROOT,
        env=os.environ | {"KERNEL_BENCH_S": "900"},
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr
    passed = re.search(r" (\d+) passed, \d+ deselected in ", done.stdout)
    assert passed is not None, done.stdout
    assert int(passed[1]) >= 48  # a bus that was not found would leave its tests out
