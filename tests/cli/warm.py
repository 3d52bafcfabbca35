"""A command in a process of its own without the imports of one: a process that has them forks itself for each command.

Most commands that tests run take longer to import than to do their work. A forked one has its own descriptors, folder,
environment and ends as an interpreter does; it differs from `python -c` in nothing but what is imported already.
"""

import atexit
import gc
import importlib
import json
import os
import pkgutil
import socket
import subprocess
import sys
import threading
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import leactl

ROOT = Path(__file__).parents[2]
SERVE = "from tests.cli.warm import end, serve; serve(); from leactl.cli.main import main; end(main)"
BESIDE = ("canopen", "h5py", "rich.progress", "scipy.ndimage", "scipy.optimize", "scipy.signal", "scipy.stats", "yaml")
AT_START = ("LANG", "LC_", "PYTHON", "TZ", "FORCE_COLOR")  # what an interpreter and its imports read of the environment
MESSAGE = 1 << 20  # bytes, of arguments and environment
PIPE = 1 << 16  # bytes that a pipe takes before they are read
WORTH_ITS_IMPORTS = 3  # commands; a warm process takes a core as long as two or three interpreters


def import_all():
    """Import leactl whole, but modules for packages that are not installed here."""
    for module in pkgutil.walk_packages(leactl.__path__, "leactl."):
        if module.name.endswith("__main__"):
            continue
        try:
            importlib.import_module(module.name)
        except ModuleNotFoundError as missing:  # an extra's package
            if (missing.name or "").startswith("leactl"):
                raise


def at_start(environment):
    return {name: value for name, value in environment.items() if name.startswith(AT_START)}


USUAL = tuple(sorted(at_start(os.environ).items()))


class Warm:
    """The process that forks, with this environment at its start, and the socket over which it is asked."""

    def __init__(self, environment):
        self.socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            self.process = subprocess.Popen(
                [sys.executable, "-c", SERVE, str(other.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,  # never read: the streams of a forked process are made for a pipe
                stderr=subprocess.PIPE,
                pass_fds=[other.fileno()],
                cwd=ROOT,
                env={name: os.environ[name] for name in os.environ.keys() - at_start(os.environ)} | environment,
            )
        atexit.register(self.close)

    def close(self):
        self.socket.close()
        self.process.communicate()

    def run(self, arguments, environment, input=None):
        """Exit status, output and errors of a command in this folder; without input it has this process's own."""
        pipes = [os.pipe() for _ in range(2)]
        given = 0 if input is None else holding(input)
        asked = json.dumps([arguments, os.getcwd(), environment]).encode()
        socket.send_fds(self.socket, [asked], [given, *(write for _, write in pipes)])
        for descriptor in (*(write for _, write in pipes), *([given] if given else [])):
            os.close(descriptor)
        with ThreadPoolExecutor(1) as beside, open(pipes[0][0]) as out, open(pipes[1][0]) as error:
            reading = beside.submit(error.read)
            output, errors = out.read(), reading.result()  # before the files are closed
        status = int(self.socket.recv(MESSAGE))
        return subprocess.CompletedProcess(arguments, status, output, errors)


def holding(text):
    """Descriptor of the reading end of a pipe that holds a text."""
    content = text.encode()
    if len(content) > PIPE:
        raise ValueError(f"{len(content)} bytes of input: a pipe holds {PIPE}")
    reading, writing = os.pipe()
    with open(writing, "wb") as file:
        file.write(content)
    return reading


_asked = Counter()


@cache
def _warm(environment):
    return Warm(dict(environment))


def run(arguments, environment=None, input=None):
    """Run a command, or give None where few commands had the same environment at their start: for an interpreter."""
    environment = dict(os.environ) if environment is None else environment
    first = tuple(sorted(at_start(environment).items()))
    _asked[first] += 1
    # packages in a folder of a test may change between commands, and a warm process would not see it
    others = environment.get("PYTHONPATH") != dict(USUAL).get("PYTHONPATH")
    if first != USUAL and (others or _asked[first] < WORTH_ITS_IMPORTS):
        return None
    return _warm(first).run(arguments, environment, input)


def serve():
    """Fork for each command that is asked for; returns in the forked processes alone."""
    # before any other, since it asks for matrix products in one thread: no thread outlives a fork
    importlib.import_module("leactl.cli.main")
    import_all()
    for name in BESIDE:
        importlib.import_module(name)
    gc.freeze()  # or a collection in a forked process writes to, and so copies, all that it shares
    connection = socket.socket(fileno=int(sys.argv[1]))
    while True:
        asked, descriptors, _, _ = socket.recv_fds(connection, MESSAGE, 3)
        if not asked:
            sys.exit()
        process = os.fork()
        if process == 0:
            connection.close()
            _become(*json.loads(asked), descriptors)
            return
        for descriptor in descriptors:
            os.close(descriptor)
        _, status = os.waitpid(process, 0)
        connection.send(str(os.waitstatus_to_exitcode(status)).encode())


def _become(arguments, folder, environment, descriptors):
    for standard, descriptor in enumerate(descriptors):
        os.dup2(descriptor, standard)
        os.close(descriptor)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["-c", *arguments]


def end(main):
    """Run the command and end as an interpreter does, without the taking apart of what is imported."""
    try:
        main()
    except SystemExit as ended:
        if not isinstance(ended.code, int) or threading.active_count() > 1:
            raise
        status = ended.code
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
