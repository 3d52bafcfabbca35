"""A command in a process of its own without the imports of one: a process that has them forks itself for each command.

Most commands that tests run take longer to import than to do their work. A forked one has its own descriptors, folder,
environment and ends as an interpreter does; it differs from `python -c` in nothing but what is imported already.
"""

import atexit
import gc
import json
import os
import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
SERVE = "from tests.cli.warm import end, serve; serve(); from leactl.cli.main import main; end(main)"
IMPORTED = (
    "leactl.cli.main",  # before any other, since it asks for matrix products in one thread: no thread outlives a fork
    *("canopen", "h5py", "pydantic", "rich.progress", "scipy.linalg", "scipy.optimize", "scipy.signal", "yaml"),
    *("leactl.analysis.analyze", "leactl.cli.bench", "leactl.cli.protocol", "leactl.cli.runs"),
    *("leactl.emulation.bench.emulated_bench", "leactl.protocol.protocolfile", "leactl.runner.session"),
)
AT_START = ("LANG", "LC_", "PYTHON", "TZ", "FORCE_COLOR")  # what an interpreter and its imports read of the environment
MESSAGE = 1 << 20  # bytes, of arguments and environment


def at_start(environment):
    return {name: value for name, value in environment.items() if name.startswith(AT_START)}


class Warm:
    """The process that forks, and the socket over which it is asked."""

    def __init__(self):
        self.environment = at_start(os.environ)
        self.socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            self.process = subprocess.Popen(
                [sys.executable, "-c", SERVE, str(other.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,  # never read: the streams of a forked process are made for a pipe
                stderr=subprocess.PIPE,
                pass_fds=[other.fileno()],
                cwd=ROOT,
            )
        atexit.register(self.close)

    def close(self):
        self.socket.close()
        self.process.communicate()

    def run(self, arguments, environment):
        """Exit status, output and errors of a command in this folder."""
        pipes = [os.pipe() for _ in range(2)]
        asked = json.dumps([arguments, os.getcwd(), environment]).encode()
        socket.send_fds(self.socket, [asked], [0, *(write for _, write in pipes)])
        for _, write in pipes:
            os.close(write)
        with ThreadPoolExecutor(1) as beside, open(pipes[0][0]) as out, open(pipes[1][0]) as error:
            errors = beside.submit(error.read)
            output = out.read()
        status = int(self.socket.recv(MESSAGE))
        return subprocess.CompletedProcess(arguments, status, output, errors.result())


@cache
def _warm():
    return Warm()


def run(arguments, environment=None):
    """Run a command, or give None where an interpreter would have to start in another environment."""
    environment = dict(os.environ) if environment is None else environment
    warm = _warm()
    return warm.run(arguments, environment) if at_start(environment) == warm.environment else None


def serve():
    """Fork for each command that is asked for; returns in the forked processes alone."""
    for name in IMPORTED:
        __import__(name)
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
