"""Work in a process of its own, bounded in time, whose memory and last words are known afterwards."""

import contextlib
import io
import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable
from typing import NamedTuple

LONGEST_S = 5.0  # of a processor, so that other work on the machine does not count
LONGEST_WAIT_S = 60  # by the clock
MOST_MB = 300.0
FRESH_MB = 100.0  # of a process that has just imported what it needs; a forked one begins with all that others imported


class Outcome(NamedTuple):
    """How it ended: the exit status, a signal's number below zero, what was said, processor time, most memory."""

    status: int
    said: str
    seconds: float
    megabytes: float

    @property
    def fault(self) -> str:
        """What must not be; empty where it ended as it should."""
        if self.status < 0:
            return f"ended by {signal.Signals(-self.status).name} after {self.seconds:.1f} s"
        if self.status not in (0, 2):
            return f"status {self.status}"
        if self.seconds > LONGEST_S or self.megabytes > MOST_MB:
            return f"took {self.seconds:.1f} s and {self.megabytes:.0f} MB"
        return "" if "internal error" not in self.said and "Traceback" not in self.said else "internal error"


def resident_mb() -> float:
    """Memory of this process."""
    with open("/proc/self/statm", encoding="ascii") as told:
        return int(told.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def outcome(work: Callable[[], int]) -> Outcome:
    """Run `work`, which returns an exit status, in a child."""
    with tempfile.TemporaryFile() as said:
        inherited = resident_mb()
        child = os.fork()
        if not child:
            status = 70
            try:
                os.dup2(said.fileno(), 1)
                os.dup2(said.fileno(), 2)
                sys.stdout, sys.stderr = (
                    io.TextIOWrapper(io.FileIO(number, "w", closefd=False), errors="replace") for number in (1, 2)
                )
                streams = sys.stdout, sys.stderr  # kept: a command puts others around them
                signal.signal(signal.SIGALRM, signal.SIG_DFL)
                signal.signal(signal.SIGPROF, signal.SIG_DFL)
                signal.alarm(LONGEST_WAIT_S)
                signal.setitimer(signal.ITIMER_PROF, 2 * LONGEST_S)
                status = work()
            except SystemExit as end:
                status = end.code if isinstance(end.code, int) else 70
            except BaseException:  # whatever it is, it is an internal error
                traceback.print_exc()
            finally:
                with contextlib.suppress(ValueError):  # a command may have closed them
                    for stream in (sys.stdout, sys.stderr, *streams):
                        stream.flush()
                os._exit(status)
        _, status, usage = os.wait4(child, 0)
        said.seek(0)
        return Outcome(
            os.waitstatus_to_exitcode(status),
            said.read(100_000).decode(errors="replace"),
            usage.ru_utime + usage.ru_stime,
            FRESH_MB + max(0.0, usage.ru_maxrss / 1024.0 - inherited),
        )
