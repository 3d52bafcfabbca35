"""`leactl demo` beside the compiler of the interpreter that runs it: how much of a processor it asks for."""

import compileall
import os
import resource
import shutil
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

PACKAGES = ("asyncio", "email", "json", "unittest", "xml", "http", "logging", "importlib", "concurrent")
LIMIT = 150


def test_the_demo_asks_for_a_minute_of_a_processor_not_ten(figure, tmp_path):
    for package in PACKAGES:
        shutil.copytree(Path(sysconfig.get_path("stdlib")) / package, tmp_path / "library" / package)
    compiled = min(_compilation_s(tmp_path / "library") for _ in range(3))
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [Path(sys.executable).with_name("leactl"), "demo"],
        cwd=tmp_path,
        env={**os.environ, "LEACTL_STATE": str(tmp_path / "state"), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        check=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    demo = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    ratio = demo / compiled
    figure(f"leactl demo: {ratio:.0f} ({demo:.0f} s beside {compiled:.2f} s) of compiling nine packages; limit {LIMIT}")
    assert ratio <= LIMIT


def _compilation_s(folder: Path) -> float:
    began = time.process_time()
    assert compileall.compile_dir(folder, quiet=2, force=True)
    return time.process_time() - began
