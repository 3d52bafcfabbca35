"""A Dask scheduler and its workers on this machine, as processes."""

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

DASK = [sys.executable, "-m", "dask"]
NOTHING: Mapping[str, str] = {}
Processes = list["subprocess.Popen[str]"]


@contextmanager
def dask_clusters() -> Iterator[Callable[..., tuple[str, Processes]]]:
    """A function that gives the address of a new scheduler with as many workers as asked for, and their processes.

    Options of the workers stand for `--nthreads 1`; their environment is added to that of this
    process, where an empty value takes a variable away.
    """
    with ExitStack() as stack:

        def begin(words: list[str], told: str, environment: Mapping[str, str]) -> tuple["subprocess.Popen[str]", str]:
            process, found = _started(words, told, environment)
            stack.enter_context(process)
            stack.callback(process.kill)
            return process, found

        def make(workers: int, *options: str, environment: Mapping[str, str] = NOTHING) -> tuple[str, Processes]:
            here = ["--host", "127.0.0.1", "--no-dashboard", "--port", "0"]
            _, address = begin(["scheduler", *here], r"Scheduler at:\s+(tcp://\S+)", {})
            words = ["worker", address, "--no-nanny", "--no-dashboard", *(options or ("--nthreads", "1"))]
            made = [begin(words, r"Registered to:\s+(tcp://\S+)", environment)[0] for _ in range(workers)]
            return address, made

        yield make


def _started(words: list[str], told: str, environment: Mapping[str, str]) -> tuple["subprocess.Popen[str]", str]:
    """A process of Dask, once it has told what is waited for, and what that is."""
    here = {"PYTHONPATH": os.pathsep.join([str(Path.cwd()), os.environ.get("PYTHONPATH", "")])}
    everything = os.environ | here | {"OPENBLAS_NUM_THREADS": "1"} | environment
    env = {name: value for name, value in everything.items() if value}
    process = subprocess.Popen([*DASK, *words], stderr=subprocess.PIPE, text=True, env=env)
    assert process.stderr is not None
    for line in process.stderr:
        if found := re.search(told, line):
            return process, found[1]
    raise AssertionError(f"{words}: ended with {process.wait()}")
