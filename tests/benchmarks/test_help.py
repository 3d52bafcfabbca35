"""`leactl --help` beside the import of the library that prints it."""

import subprocess
import sys
import time
from pathlib import Path

from tests.benchmarks.rounds import compare

LIMIT = 1.3


def test_help_is_there_at_once(figure):
    leactl = Path(sys.executable).with_name("leactl")

    def run(*command):
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)

    result = compare(
        lambda: run(leactl, "--help"),
        lambda: run(sys.executable, "-c", "import typer"),
        timer=time.perf_counter,
    )
    figure(f"leactl --help: {result:ms} of python -c 'import typer'; limit {LIMIT}")
    assert result.ratio <= LIMIT
