"""Run the installed command as a person's shell would."""

import subprocess
import sys

import h5py

from tests.cli import warm

COMMAND = [sys.executable, "-c", "from leactl.cli.main import main; main()"]


def leactl(*arguments, input=None, **environment):
    words = [str(argument) for argument in arguments]
    forked = warm.run(words, environment or None, input)
    return forked or interpreted(*words, input=input, **environment)


def interpreted(*arguments, input=None, **environment):
    """By an interpreter of its own, which is a child of this process: what it takes can be asked for."""
    command = [*COMMAND, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, input=input, env=environment or None, check=False)


def start(*arguments):
    return subprocess.Popen(
        [*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1
    )


def live_run(here, process):
    """Path of the run once its first rows are on the disk."""
    while process.poll() is None:
        for path in (here / "runs").glob("*.h5"):
            try:
                with h5py.File(path, "r", swmr=True) as file:
                    if len(file["streams/loop/time"]) > 5:
                        return path
            except OSError:
                continue
    raise AssertionError(process.communicate())
